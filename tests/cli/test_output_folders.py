"""Output folders: never over files of others."""

import json
import os
from pathlib import Path
from types import SimpleNamespace

import pytest
from cli.two_link_files import refused, tree

import lieid_casadi as lieid
from lieid_casadi.errors import OutputError
from lieid_casadi.output_folder import MANIFEST, output_folder, write_folder


def export(run, folder, *more):
    return run("export", "fit.json", "--to", "c", "-o", folder, *more)


@pytest.mark.parametrize("force", [[], ["--force"]])
def test_a_folder_without_a_manifest_is_never_replaced(work, run, force):
    (work / "out").mkdir()
    (work / "out" / "notes.txt").write_text("notes")
    refused(export(run, "out", *force), "out", "not empty", MANIFEST)
    refused(run("demo", "-o", "out", *force), "out", "not empty", MANIFEST)
    assert tree(work / "out") == {"notes.txt": b"notes"}


def test_an_interrupted_demo_ends_at_once_and_writes_nothing(work, run, monkeypatch):
    best = SimpleNamespace(interrupted=True, duration=1.0)
    monkeypatch.setattr("lieid_casadi.demo.excite", lambda *arguments, **options: best)
    assert run("demo", "--robot", "two_link") == (130, "", "lieid demo: interrupted\n")
    assert not Path("lieid-demo").exists()


def test_files_that_the_manifest_does_not_list_are_kept(work, run):
    assert export(run, "out")[0] == 0
    (work / "out" / "build").mkdir()
    (work / "out" / "build" / "mine.o").write_text("mine")
    (work / "out" / "mine.c").write_text("mine")
    refused(export(run, "out"), "--force")
    status, _, err = export(run, "out", "--force", "--prefix", "scara")
    assert status == 0, err
    made = tree(work / "out")
    assert made["build/mine.o"] == made["mine.c"] == b"mine"
    assert "scara.h" in made
    assert "arm.h" not in made
    listed = set(json.loads(made[MANIFEST])["files"])
    assert listed == made.keys() - {"build/mine.o", "mine.c", MANIFEST}


@pytest.mark.parametrize("name", ["../mine", "/mine", "sub/../../mine", "link/mine"])
def test_a_manifest_cannot_name_files_elsewhere(tmp_path, name):
    folder, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "mine").write_bytes(b"mine")
    (tmp_path / "mine").write_bytes(b"mine")
    write_folder(folder, {"a": b"1"})
    (folder / "link").symlink_to(elsewhere)
    (folder / MANIFEST).write_text(json.dumps({"program": "lieid-casadi", "files": ["a", name]}))
    write_folder(folder, {"b": b"2"}, force=True)
    assert (tmp_path / "mine").exists()
    assert (elsewhere / "mine").exists()
    assert not (folder / "a").exists()


@pytest.mark.parametrize("exists", [False, True])
def test_an_error_on_the_way_leaves_a_folder_as_it_was(tmp_path, exists):
    if exists:
        write_folder(tmp_path / "out", {"a": b"1"})
    before = tree(tmp_path)

    def half():
        with output_folder(tmp_path / "out", force=True) as fresh:
            (fresh / "a").write_bytes(b"2")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        half()
    assert tree(tmp_path) == before
    assert os.listdir(tmp_path) == (["out"] if exists else [])


def test_library_functions_do_not_replace_files_of_others(work):
    fit = lieid.Fit.load("fit.json")
    from lieid_casadi.exporters.export import export

    for made in (lambda: export(fit, ".", force=True, to="c"), lambda: fit.save("inner/..")):
        before = tree(work)
        with pytest.raises(OutputError):
            made()
        assert tree(work) == before
