"""The page of the viewer: its markup, style and script, put together from the package's files."""

import base64
import hashlib
import re
from functools import cache
from importlib.resources import files

PARTS = {"markup": "viewer.html", "style": "viewer.css", "script": "viewer.js"}


@cache
def part(name: str) -> str:
    """Return a part of the page: ``"markup"``, ``"style"`` or ``"script"``."""
    return (files("jaxurban.viewer") / "page" / PARTS[name]).read_text(encoding="utf-8")


def html_page(data: str = "", title: str = "jaxurban") -> str:
    """Return the page as one HTML file.

    Args:
      data: JSON of all answers, for a page that asks nobody; "" for one that asks its server.
      title: of the window.
    """
    held = data.replace("<", "\\u003c")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width">\n<link rel="icon" href="data:,">\n'
        f"{_policy_tag(data)}<title>{_escaped(title)}</title>\n<style>\n{part('style')}</style>\n</head>\n"
        f'<body style="margin: 0">\n<div class="jv">\n{part("markup")}</div>\n'
        f'<script type="application/json" id="jv-data">{held}</script>\n'
        f'<script type="module">\n{part("script")}</script>\n</body>\n</html>\n'
    )


def policy_of(page: str, connect: str) -> str:
    """Return what a page may load: its own script and style, and requests to ``connect``."""
    script = re.findall(r'<script type="module">(.*?)</script>', page, re.DOTALL)[-1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data: blob:; "
        f"connect-src {connect}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


def _policy_tag(data: str) -> str:
    """Return the policy of a page that is a file, which has no server to state it."""
    if not data:
        return ""
    rules = policy_of(f'<script type="module">\n{part("script")}</script>', "'none'").rpartition("; frame-ancestors")[0]
    return f'<meta http-equiv="Content-Security-Policy" content="{rules}">\n'


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;")
