"""The page on receiver clocks holds the table that its script draws."""

import pytest

from benchmarks.clocks import PAGE, TABLE, sky_task, table


@pytest.mark.slow
@pytest.mark.data
def test_the_table_of_the_page_is_what_the_maps_give(data_dir):
    (held,) = TABLE.findall(PAGE.read_text(encoding="utf-8"))
    assert held == table(sky_task(data_dir / "tokyo"))
