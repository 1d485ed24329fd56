"""Time from a click in the workbench to updated figures, and memory: p50 and p95 of many clicks.

    python tests/benchmarks/workbench_latency.py [--samples 1000000] [--clicks 200] [--json FILE]

Without ``--samples`` on the UR10e recordings (80 s to fit, LIEID_RECORDINGS), otherwise on
simulated recordings of that many samples. Every second click adds another effect of the library to
the first model, on another joint, so that it needs a fit; the others undo it. "page" is the time
from the click to the new number and drawn figures in the page, in a browser that renders in
software on the same cores; "browser CPU" is that of the main thread of the page, "server CPU" that
of the server without the processes that fit. Standard
deviations and noise floor follow later and are not part of these times: the next click comes half a
second after the numbers, whether they are there or not. Memory: of the server and its processes,
and of the page, after a tenth of the clicks and after all.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from real_arms import UR10E
from workbench.server_process import Page, Server

import lieid_casadi as lieid
from lieid_casadi.workbench.session import (
    FoundEffects,
    ProposedEffect,
    RecordingInput,
    Session,
    SessionContent,
    WorkbenchInputs,
)

KINDS = (
    "load_friction", "stribeck", "viscous_polynomial", "presliding", "position_friction",
    "transmission_coupling", "armature", "torque_delay", "viscous_asymmetric", "torque_ripple",
    "bias_drift", "torque_gain", "position_spring",
    "joint_elasticity", "torque_lowpass",
)  # fmt: skip
JOINTS = 6
#: One on each joint: a kind comes again after all others.
EFFECTS = [
    f"{kind}:{j}<{j % JOINTS + 1}" if kind == "transmission_coupling" else f"{kind}:{j}"
    for turn in range(JOINTS)
    for k, kind in enumerate(KINDS)
    for j in [(turn + k) % JOINTS + 1]
]
COMPLETE = '[data-testid="verdict"][data-complete="true"]'
# Ends once the number is new and every chart that can be seen was drawn since; see `measure`.
CLICK = """
const [name, done] = arguments;
const find = (id) => document.querySelector(`[data-testid="${id}"]`);
const begun = performance.now();
const seen = (id) => {
  const box = find(id).getBoundingClientRect();
  return box.top < innerHeight && box.bottom > 0;
};
const missing = new Set(["torque-plot", "residual-plot", "waterfall"].filter(seen));
for (const id of [...missing]) {
  const { chart } = getElement(find(id).id.slice(1));
  const drawn = () => { missing.delete(id); chart.off("rendered", drawn); };
  chart.on("rendered", drawn);
}
find(name).click();
let fitting = false;
function look() {
  const waiting = find("joint-1").classList.contains("outdated");
  fitting = fitting || waiting;
  if (fitting && !waiting && !missing.size) {
    const took = performance.now() - begun;
    done(took);
  } else if (performance.now() - begun > 60000) done(-1);
  else setTimeout(look, 4);
}
look();
"""


def ur10e():
    """Return the inputs of the UR10e recordings."""
    roles = {
        "excitation_30s": "train",
        "excitation_50s": "train",
        "excitation_14_harmonics": "test",
    }
    return WorkbenchInputs(
        robot=str(UR10E / "ur10e.urdf"),
        recordings=tuple(
            RecordingInput(str(UR10E / f"{name}.csv.gz"), role) for name, role in roles.items()
        ),
    )


def simulated(samples: int, folder: Path):
    """Return inputs of recordings of the UR10e's model at 1 kHz with this number of rows."""
    robot = lieid.Robot.load(UR10E / "ur10e.urdf")
    rigid = lieid.compile(lieid.Model(robot)).inverse_dynamics
    recordings = []
    for seed, (role, share) in enumerate((("train", 0.7), ("test", 0.3))):
        random = np.random.default_rng(seed)
        t = np.arange(int(share * samples)) * 1e-3
        q, dq, ddq = (np.zeros((len(t), robot.n)) for _ in range(3))
        for joint in range(robot.n):
            for k in range(1, 6):
                w = 2 * np.pi * k / 20 * (1 + 0.05 * random.standard_normal())
                a, phase = random.uniform(0.2, 0.6) / k, random.uniform(0.0, 6.0)
                q[:, joint] += a * np.sin(w * t + phase)
                dq[:, joint] += a * w * np.cos(w * t + phase)
                ddq[:, joint] -= a * w * w * np.sin(w * t + phase)
        tau = rigid(q, dq, ddq, robot.link_parameters)
        tau += np.sign(dq) * [8, 8, 5, 1, 1, 1] + dq * [5, 5, 3, 0.5, 0.5, 0.5]
        tau += random.standard_normal(tau.shape) * [1, 1, 1, 0.2, 0.2, 0.2]
        file = folder / f"{role}.npz"
        lieid.Recording.from_arrays(t, q, dq, tau, name=role).save(file)
        recordings.append(RecordingInput(str(file), role))
    return WorkbenchInputs(robot=str(UR10E / "ur10e.urdf"), recordings=tuple(recordings))


def thread_time(page) -> float:
    """Return the CPU time of the page's main thread so far, s."""
    metrics = page.driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return next(m["value"] for m in metrics if m["name"] == "TaskDuration")


def server_time(server) -> float:
    """Return the CPU time of the server without its processes so far, s."""
    fields = Path(f"/proc/{server.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory(page, server) -> tuple[float, float]:
    """Return the memory of the server with its processes, and of the page, MB."""
    children = Path(f"/proc/{server.process.pid}/task/{server.process.pid}/children").read_text()
    texts = [Path(f"/proc/{p}/status").read_text() for p in [server.process.pid, *children.split()]]
    living = [text.partition("VmRSS:")[2] for text in texts if "VmRSS:" in text]  # not ended
    kilobytes = [int(text.split()[0]) for text in living]
    page.driver.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
    heap = page.driver.execute_cdp_cmd("Runtime.getHeapUsage", {})["usedSize"]
    return round(sum(kilobytes) / 1e3, 1), round(heap / 1e6, 1)


def measure(inputs: WorkbenchInputs, folder: Path, clicks: int):
    """Return the times of the page, s, one per fit, and the memory."""
    words = [inputs.robot]
    for role in ("train", "test"):
        words += [f"--{role}", *inputs.paths(role)]
    server = Server(*words, folder=folder / "sessions")
    page = Page(1300, 900)
    page.driver.set_script_timeout(90)
    page.driver.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
    effects = EFFECTS[: clicks // 2]
    try:
        page.driver.get(server.url)
        page.wait(lambda: page.number("error-1") > 0.0, "the first fit", 300.0)
        name = page.driver.current_url.partition("session=")[2]
        file = folder / "sessions" / f"{name}.json"
        content = msgspec.json.decode(file.read_bytes(), type=SessionContent)
        session: Session = content.session
        proposed = tuple(
            ProposedEffect(label, label.partition(":")[0], (1,), 0, 1.0, 0.5) for label in effects
        )
        found = FoundEffects("effect_found", "", proposed, session.history[0].effects)
        content.session = replace(session, found=found)
        other = "f" * 16
        (folder / "sessions" / f"{other}.json").write_bytes(
            msgspec.json.encode(msgspec.to_builtins(content))
        )
        page.driver.get(f"{server.url}&session={other}")
        page.wait(lambda: page.elements("candidate-load_friction-1"), "the proposals", 300.0)
        page.wait(lambda: page.number("error-1") > 0.0, "the first fit", 300.0)
        page.wait(lambda: page.driver.find_elements("css selector", COMPLETE), "the rest", 300.0)
        time.sleep(5.0)  # the second process has started, curves are computed
        times, used = [], []
        for k, label in enumerate(effects):
            spot = label.replace(":", "-").partition("<")[0]
            before, served = thread_time(page), server_time(server)
            took = page.driver.execute_async_script(CLICK, f"candidate-{spot}") / 1000.0
            drawing = thread_time(page) - before
            serving = server_time(server) - served
            times.append((label, took, drawing, serving))
            text = f"{took:.2f} s, CPU of browser {drawing:.2f} s, of server {serving:.2f} s"
            sys.stdout.write(f"{label:28} page {text}\n")
            sys.stdout.flush()
            time.sleep(0.5)
            page.click("undo")
            page.wait(lambda: "in the model" not in page.driver.page_source, "undo")
            time.sleep(0.5)
            if k + 1 in (max(len(effects) // 10, 1), len(effects)):
                used.append(memory(page, server))
        return times, used
    finally:
        page.driver.quit()
        server.stop()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--samples", type=int)
    parser.add_argument("--clicks", type=int, default=200)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        inputs = ur10e() if args.samples is None else simulated(args.samples, folder)
        times, used = measure(inputs, folder, args.clicks)
    both = np.array([row[1:] for row in times])
    result = {
        name: {f"p{p}": round(float(np.percentile(values, p)), 3) for p in (50, 95)}
        for name, values in zip(("page", "browser CPU", "server CPU"), both.T, strict=True)
    }
    result["MB of server and page"] = used
    sys.stdout.write(f"{result}\n")
    if args.json:
        args.json.write_text(json.dumps(result))


if __name__ == "__main__":
    main()
