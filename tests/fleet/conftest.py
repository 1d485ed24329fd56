import hashlib
from pathlib import Path

import pytest
from fleet.simulated_fleet import fit_of, healthy_arm, recorded, tcp_cluster, write_fleet


@pytest.fixture(scope="session")
def scheduler():
    """Address of a Dask cluster in this process: workers need not import anything again."""
    with tcp_cluster(1) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="session")
def two_arms(tmp_path_factory) -> Path:
    """Folder of a fleet of two arms with four nights each; not to be changed."""
    folder = tmp_path_factory.mktemp("fleet")
    (folder / "fits").mkdir()
    for seed, serial in ((1, "A1"), (2, "A2")):
        fit_of("two_link", seed, 15.0).save(folder / "fits" / f"{serial}.json")
        nights = folder / "nights" / serial
        nights.mkdir(parents=True)
        arm = healthy_arm("two_link", seed)
        for k in range(4):
            recording = recorded("two_link", arm, motion_seed=k, seed=100 * seed + k, duration=15.0)
            recording.save(nights / f"2026-01-0{k + 1}.csv")
    write_fleet(folder, ["A1", "A2"])
    return folder


@pytest.fixture
def fleet_folder(two_arms, tmp_path) -> Path:
    """A copy of the fleet of two arms, to change."""
    import shutil

    return Path(shutil.copytree(two_arms, tmp_path / "fleet"))


@pytest.fixture
def sha_of():
    return lambda path: hashlib.sha256(Path(path).read_bytes()).hexdigest()
