"""Kill a process before each of its file operations while it writes; run as a program.

Writes a file, a new folder and an existing folder below the folder that is given. Before the k-th
operation the writing process ends as by ``kill -9``, for k = 0, 1, … until it gets to its end. Each
file must then be the old or the new one, and the next write must work and clean up.
"""

import os
import shutil
import signal
import sys
from pathlib import Path

from lieid_casadi.atomic_file import atomic_binary, is_temporary
from lieid_casadi.output_folder import MANIFEST, listed_files, write_folder

OPERATIONS = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "shutil.rmtree"}
OLD = {"a.c": b"old" * 5000, "gone.c": b"gone", "sub/b.c": b"old", "sub/c.c": b"old"}
NEW = {"a.c": b"new" * 6000, "sub/b.c": b"new", "more/d.c": b"new"}


def write_file(folder):
    with atomic_binary(folder / "file") as file:
        file.write(NEW["a.c"])


def write_new_folder(folder):
    write_folder(folder / "deep" / "out", NEW)


def write_existing_folder(folder):
    write_folder(folder / "out", NEW, force=True)


def killed_at(k, work, folder):
    """Run some work in a child that is killed before its k-th operation; return whether it was."""
    child = os.fork()
    if child == 0:
        count = 0

        def hook(event, arguments):
            nonlocal count
            if event in OPERATIONS:
                if count == k:
                    os.kill(os.getpid(), signal.SIGKILL)
                count += 1

        sys.addaudithook(hook)
        work(folder)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    if os.WIFEXITED(status):
        assert os.WEXITSTATUS(status) == 0
        return False
    return True


def files(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not any(is_temporary(part) for part in path.parts)
    }


def check_file(folder):
    assert (folder / "file").read_bytes() in (OLD["a.c"], NEW["a.c"])


def check_new_folder(folder):
    if (folder / "deep" / "out").exists():
        made = files(folder / "deep" / "out")
        assert made.pop(MANIFEST)
        assert made == NEW


def check_existing_folder(folder):
    made = files(folder / "out")
    assert made.pop("mine") == b"mine"
    assert listed_files(folder / "out") is not None
    del made[MANIFEST]
    for name, content in made.items():
        assert content in (OLD.get(name), NEW.get(name)), name
    for name in OLD.keys() & NEW.keys():
        assert name in made


CASES = (
    (write_file, check_file),
    (write_new_folder, check_new_folder),
    (write_existing_folder, check_existing_folder),
)


def main(root):
    os.fsync = lambda handle: None  # slow, and needed only where the machine fails
    for work, check in CASES:
        k = 0
        while True:
            folder = root / f"{work.__name__}_{k}"
            (folder / "out").mkdir(parents=True)
            (folder / "file").write_bytes(OLD["a.c"])
            shutil.rmtree(folder / "out")
            write_folder(folder / "out", OLD)
            (folder / "out" / "mine").write_bytes(b"mine")
            killed = killed_at(k, work, folder)
            check(folder)
            if work is write_new_folder and killed and (folder / "deep" / "out").exists():
                write_folder(folder / "deep" / "out", NEW, force=True)
            elif killed:
                work(folder)
            made = files(folder)
            if work is write_file:
                assert made["file"] == NEW["a.c"]
            else:
                place = "deep/out/" if work is write_new_folder else "out/"
                assert all(made[place + name] == content for name, content in NEW.items())
                assert ("out/gone.c" in made) == (work is write_new_folder)
            if not killed:
                sys.stdout.write(f"{work.__name__}: killed before each of {k} operations\n")
                break
            k += 1


if __name__ == "__main__":
    main(Path(sys.argv[1]))
