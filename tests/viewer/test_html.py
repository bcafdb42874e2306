"""The page as one file: its size, and that it asks nobody else."""

import base64
import hashlib
import re

from jaxurban.viewer.html import html_page, part, policy_of


def hashed(script: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}"


def test_the_page_is_at_most_650_lines_of_script_and_style():
    assert len(part("script").splitlines()) + len(part("style").splitlines()) <= 650
    assert max(len(line) for name in ("script", "style") for line in part(name).splitlines()) <= 120


def test_the_page_names_no_other_host():
    assert not re.findall(r"https?:|//[a-z]+\.", html_page())
    assert not re.findall(r"@import|url\(", part("style"))


def test_data_in_the_page_cannot_end_its_element():
    page = html_page('{"a": "</script><script>alert(1)</script>"}', "<b>")
    assert "alert(1)</script>" not in page
    assert "<title>&lt;b&gt;</title>" in page
    assert "connect-src 'none'" in page


def test_the_policy_allows_the_page_its_own_script_alone():
    policy = policy_of("'self'")
    script = re.findall(r'<script type="module">(.*?)</script>', html_page(), re.DOTALL)[-1]
    assert f"script-src '{hashed(script)}'" in policy
    assert "unsafe-eval" not in policy
