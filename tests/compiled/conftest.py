"""Compiled code of these tests is kept in a separate cache."""

import pytest

from lieid_casadi.compiled import cache as disk
from lieid_casadi.compiled import kernels
from lieid_casadi.compiled.kernels import find_compiler
from lieid_casadi.errors import CompilerError


@pytest.fixture(scope="session")
def test_cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def own_cache(test_cache, monkeypatch):
    monkeypatch.setenv("LIEID_CACHE_DIR", str(test_cache))


@pytest.fixture
def fresh_process(monkeypatch, tmp_path):
    """The state of a process that has compiled nothing and met no failure; its empty cache."""
    cache = tmp_path / "cache"
    monkeypatch.setenv("LIEID_CACHE_DIR", str(cache))
    monkeypatch.setattr(kernels, "_libraries", {})
    monkeypatch.setattr(kernels.CompilerFailure, "reason", None)
    monkeypatch.setattr(disk.tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    disk._notice.cache_clear()
    return cache


@pytest.fixture
def compiler():
    """The system's compiler; skips without one."""
    try:
        return find_compiler()
    except CompilerError as error:
        pytest.skip(str(error))
