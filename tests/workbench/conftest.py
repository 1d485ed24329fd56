import pytest
from workbench.server_process import CHROMIUM, DRIVER, Page, Server
from workbench.two_link_files import write_recordings


@pytest.fixture(scope="session")
def two_link_files(tmp_path_factory):
    return write_recordings(tmp_path_factory.mktemp("two_link"))


@pytest.fixture
def start(tmp_path):
    """Start servers that are ended after the test."""
    servers = []

    def started(*words: str, **options) -> Server:
        servers.append(Server(*words, folder=tmp_path / "sessions", **options))
        return servers[-1]

    yield started
    for server in servers:
        if server.process.poll() is None:
            server.stop()


@pytest.fixture
def browse(tmp_path):
    """Open pages in a browser that is closed after the test."""
    if not (CHROMIUM.exists() and DRIVER.exists()):
        pytest.skip(f"no {CHROMIUM} and {DRIVER}")
    pytest.importorskip("selenium", reason="no selenium")
    pages = []

    def opened(url: str, **options) -> Page:
        pages.append(Page(downloads=tmp_path / "downloads", **options))
        pages[-1].driver.get(url)
        return pages[-1]

    yield opened
    for page in pages:
        page.driver.quit()
