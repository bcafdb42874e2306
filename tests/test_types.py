"""What a type checker says of a user's script: nothing of a right one, each mistake of a wrong one."""

from pathlib import Path

import pytest
from mypy import api

from tests.test_docs import PAGES, blocks_of, name_of

HERE = Path(__file__).parent
WRONG = """import jaxurban as ju

maps = ju.build_maps(ju.sample_city("lower-manhattan"), resolution_m="coarse")
route = ju.plan(maps, (-74.01, 40.70), (-73.99, 40.72), altitude_m=60.0)
print(route.length_km)
"""
MISTAKES = {3: "arg-type", 5: "attr-defined"}

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cache(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("mypy")


def checked(cache: Path, *arguments: str | Path) -> str:
    said, fault, _ = api.run(
        ["--strict", "--config-file", "", "--cache-dir", str(cache), *map(str, arguments)]
    )
    assert not fault
    return said


def test_a_users_script_is_right_and_each_mistake_is_found(cache, tmp_path):
    wrong = tmp_path / "wrong.py"
    wrong.write_text(WRONG)
    found = checked(cache, wrong)
    for line, code in MISTAKES.items():
        assert any(
            f"wrong.py:{line}:" in said and f"[{code}]" in said for said in found.splitlines()
        ), found
    assert f"Found {len(MISTAKES)} errors" in found
    assert "Success" in checked(cache, HERE / "typed_user.py")


def test_what_readme_and_docs_show_has_the_types_that_we_ask_for(cache, tmp_path):
    pages = []
    for page in PAGES:
        if shown := [block.text for block in blocks_of(page) if block.language == "python"]:
            pages.append(tmp_path / f"{name_of(page).removesuffix('.md').replace('/', '_')}.py")
            pages[-1].write_text("\n".join(shown), encoding="utf-8")
    assert "README.py" in [page.name for page in pages]
    found = checked(
        cache, "--ignore-missing-imports", "--allow-untyped-defs", "--allow-untyped-calls", *pages
    )
    assert "Success" in found, found
