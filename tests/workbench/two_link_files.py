"""Recordings of a two-link arm with load friction on joint 1, as files."""

from pathlib import Path

import numpy as np
from comparison.two_link_data import motion, torque

import lieid_casadi as lieid


def write_recordings(folder: Path, *, load_friction: float = 0.1) -> tuple[Path, Path]:
    """Write a training and a test recording, which differ in their motion."""
    robot = lieid.robots.two_link()
    rigid = lieid.compile(robot).inverse_dynamics
    paths = []
    for seed, name in ((3, "train.npz"), (8, "test.npz")):
        t, q, dq, ddq = motion(18.0, seed=seed)
        tau = torque(q, dq, ddq)
        load = rigid(q, dq, ddq, robot.link_parameters)
        tau[:, 0] += load_friction * np.abs(load[:, 0]) * np.sign(dq[:, 0])
        tau += 0.05 * np.random.default_rng(seed).standard_normal(tau.shape)
        paths.append(folder / name)
        lieid.Recording.from_arrays(t, q, dq, tau, name=name).save(paths[-1])
    return paths[0], paths[1]
