"""The script that renews shown outputs changes stale lines alone, and names the sentences that it cannot mend."""

import pytest

from tests import renew_outputs as renew
from tests.test_docs import Block, is_shown

PAGE = """# Routes

The route of 4,321 m is 5 % longer.

- A list names 12.5 m.

```text
  length 4,321 m (shortest 4,100)
no fix on 12.5 m of the route (below 3 trees; ...
same
```

## Others

Nothing here but 5 %. The 4321 m are named again.
"""
SAID = """warning: no fix on 13.5 m of the route (below 4 wide trees; 2 masts; 17 signs)
same
  length 4,399 m (shortest 4,100)
"""


@pytest.fixture
def page(tmp_path, monkeypatch):
    file = tmp_path / "page.md"
    file.write_text(PAGE, encoding="utf-8")
    monkeypatch.setattr(renew, "PAGES", [file])
    monkeypatch.setattr(renew, "name_of", lambda page: page.name)
    return file


def test_stale_lines_alone_are_rewritten_and_stay_cut_where_they_were(page):
    (block,) = renew.blocks_of(page)
    changes = renew.changes_of(block, SAID)
    assert [change.line for change in changes] == [8, 9]
    renew.rewrite(page, changes)
    old, new = PAGE.splitlines(), page.read_text(encoding="utf-8").splitlines()
    assert new[7:9] == [
        "  length 4,399 m (shortest 4,100)",
        "no fix on 13.5 m of the route (below 4 wide trees; ...",
    ]
    assert new[:7] + new[9:] == old[:7] + old[9:]
    (block,) = renew.blocks_of(page)
    assert renew.changes_of(block, SAID) == []


def test_sentences_that_hold_an_old_number_are_named(page):
    (block,) = renew.blocks_of(page)
    stale, beside = renew.sentences_to_read({page: renew.changes_of(block, SAID)})
    assert stale == [
        "page.md:3: The route of 4,321 m is 5 % longer.",
        "page.md:5: - A list names 12.5 m.",
        "page.md:15: The 4321 m are named again.",
    ]
    assert beside == []


@pytest.mark.parametrize(
    ("shown", "printed", "renewed"),
    [
        ("a 1 ... b 2", "a 3 x y b 4", "a 3 ... b 4"),
        ("items 1, 2 ... 9 (7)", "items 3, 4 ... 8 (6)", "items 3, 4 ... 8 (6)"),
        ("of 9 m; ...", "warning: of 10 m; more", "of 10 m; ..."),
        ("cost      7.5", "cost      11.25", "cost      11.25"),
    ],
)
def test_a_line_that_replaces_another_passes_the_test_of_pages(shown, printed, renewed):
    assert renew.successor(shown, printed) == renewed
    assert is_shown(renewed, printed)


def test_a_line_unlike_all_that_is_printed_is_left_to_a_person():
    (change,) = renew.changes_of(Block("text", "routes went over trees\n", 3), "status optimal\n")
    assert change == (3, "routes went over trees", None)
