import pytest

from jaxurban.cities import download
from tests.misbehaving_server import serve


@pytest.fixture
def server(tmp_path, monkeypatch):
    """A server in this process, an empty cache, and little patience."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr(download, "BACKOFF", 0.01)
    with serve() as running:
        yield running
