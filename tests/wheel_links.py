"""Whether what an index shows of an installed jaxurban leads somewhere: ``python wheel_links.py CHECKOUT``.

Links of the README must name this version's tag and files of the checkout, and none may be relative.
"""

import re
import sys
from importlib.metadata import metadata
from pathlib import Path
from urllib.parse import urldefrag

checkout = Path(sys.argv[1])
shown = metadata("jaxurban")
urls = dict(line.split(", ") for line in shown.get_all("Project-URL"))
start = re.compile(rf"{re.escape(urls['Repository'])}/(?:raw|blob)/v{shown['Version']}/")
links = re.findall(r"\]\(([^)]+)\)", shown.get_payload())
relative = [link for link in links if not link.startswith(("https://", "#"))]
inside = [urldefrag(link).url for link in links if link.startswith(urls["Repository"])]
missing = [link for link in inside if not (checkout / start.sub("", link)).exists()]
if relative or missing or not inside:
    sys.exit(f"of the wheel's {len(links)} links these lead nowhere: {relative + missing}")
print(f"the wheel's {len(links)} links lead to files of version {shown['Version']}")
