"""What a type checker says of a user's script: nothing of a right one, each mistake of a wrong one."""

from pathlib import Path

import pytest
from mypy import api

RIGHT = Path(__file__).parent / "typed_user.py"
WRONG = """import jaxurban as ju

maps = ju.build_maps(ju.sample_city("lower-manhattan"), resolution_m="coarse")
route = ju.plan(maps, (-74.01, 40.70), (-73.99, 40.72), altitude_m=60.0)
print(route.length_km)
"""
MISTAKES = {3: "arg-type", 5: "attr-defined"}


def checked(script: Path, folder: Path) -> str:
    said, fault, _ = api.run(["--strict", "--config-file", "", f"--cache-dir={folder / 'cache'}", str(script)])
    assert not fault
    return said


@pytest.mark.slow
def test_mypy_reads_our_types_in_a_users_script(tmp_path):
    wrong = tmp_path / "wrong.py"
    wrong.write_text(WRONG)
    found = checked(wrong, tmp_path)
    for line, code in MISTAKES.items():
        assert any(f"wrong.py:{line}:" in said and f"[{code}]" in said for said in found.splitlines()), found
    assert f"Found {len(MISTAKES)} errors" in found
    assert "Success" in checked(RIGHT, tmp_path)
