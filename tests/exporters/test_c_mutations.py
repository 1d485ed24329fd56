"""The self-test of exported C fails on wrong code: statements altered or removed one at a time."""

import ctypes
import random
import re
import subprocess
import uuid
from dataclasses import dataclass

import numpy as np
import pytest
from exporters.c_arms import ARMS, made_fit, pointer

import lieid_casadi as lieid
from lieid_casadi.exporters.export import export

NUMBER = re.compile(r"(?<![\w.])\d+\.\d{3,}(?:e[-+]?\d+)?")
ASSIGNED = re.compile(
    r"^    (?:const double (?P<local>\w+)|(?P<result>[\w>.\[\]-]+)) = (?P<value>.+);$"
)


@dataclass(frozen=True)
class Mutation:
    """One line of a file, before and after."""

    file: str
    line: int
    before: str
    after: str

    def __str__(self):
        return f"{self.file}:{self.line + 1}: {self.before.strip()} -> {self.after.strip()}"


def mutations(name, text):
    """Mutations of every statement that computes, stores or copies something."""
    lines = text.splitlines()
    free = free_values(text)
    for number, line in enumerate(lines):
        for after in altered(line):
            if number not in free or "0.0 / 0.0" in after:
                yield Mutation(name, number, line, after)


def free_values(text):
    """Return lines whose values may differ as long as they are finite.

    These are sums |a| + |b| + … that are only compared with the largest number, the product that
    finds a reversal within a step (a step without one may be split at any point), the divisor of
    the motion up to the reversal, whose dividend is zero without one, and steps of Newton's method,
    which correct errors of earlier ones.
    """
    start = text.find("static void advanced(")
    end, first = text.find("\n}\n", start), text[:start].count("\n")
    defined = {
        match["local"]: (first + number, match["value"])
        for number, line in enumerate(text[start:end].splitlines())
        if (match := ASSIGNED.match(line)) and match["local"]
    }
    waiting = re.findall(r"(t\d+) <= 1\.797", text)
    found = {n for n, value in defined.values() if re.fullmatch(r"before_dq_\d \* dq_\d", value)}
    divisors = re.findall(r"= t\d+ / (t\d+);", text[start:end])
    found |= {defined[name][0] for name in divisors}
    while waiting:
        number, value = defined.get(waiting.pop(), (None, ""))
        if number is not None and re.fullmatch(r"fabs\(\w+\)|\w+ \+ \w+", value):
            found.add(number)
            waiting += re.findall(r"t\d+", value)
    return found | newton_steps(text)


def newton_steps(text):
    """Return the lines of forward dynamics if friction depends on the load."""
    if not re.search(r"= load\[\d\];", text):
        return set()
    start = text.index("void arm_forward_dynamics(")
    first, count = text[:start].count("\n"), text[start : text.index("\n}\n", start)].count("\n")
    return set(range(first, first + count))


def altered(line):
    statement = ASSIGNED.match(line)
    if statement and statement["result"] != "state->started":
        value = statement["value"]
        yield line.replace(f"= {value};", "= 0.0 / 0.0;")
        yield line.replace(f"= {value};", f"= -1.5 * ({value}) - 0.25;")
        if statement["result"]:
            yield ""
        for one, other in ((" + ", " - "), (" - ", " + "), (" * ", " + ")):
            if one in value:
                yield line.replace(one, other, 1)
    elif re.match(r"^\s+(memcpy|memset|state->|\w+_rigid_torque\(sample)", line):
        yield ""
    constant = NUMBER.search(line)
    if constant and not line.lstrip().startswith(("/*", "*")):
        wrong = repr(float(constant[0]) * (1.0 + 1e-3) or 1e-3)
        yield line[: constant.start()] + wrong + line[constant.end() :]


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    made = {}

    def written(name, fit):
        if name not in made:
            made[name] = tmp_path_factory.mktemp("mutations") / name
            export(fit(), made[name], to="c")
        return made[name]

    return written


def same_function(folder, mutation):
    """Return whether a function of arrays has the same results as before in random states.

    An example is the Coriolis matrix: terms of link parameters that do not move the arm cancel.
    """
    lines = (folder / mutation.file).read_text().splitlines()
    starts = [k for k in range(mutation.line) if lines[k].startswith(("void ", "static "))]
    first = max(starts, default=0)
    head = re.match(r"void (\w+)\(([^)]*)\) {", " ".join(lines[first : mutation.line]))
    if head is None or not all("double " in word and "[" in word for word in head[2].split(",")):
        return False
    results = []
    for name, line in (("before", mutation.before), ("after", mutation.after)):
        name = f"{name}_{uuid.uuid4().hex}"  # a library of the same name is not loaded again
        lines[mutation.line] = line
        (folder / f"{name}.c").write_text("\n".join(lines) + "\n")
        command = ["gcc", "-std=c99", "-O0", "-w", "-shared", "-fPIC", f"{name}.c"]
        command += ["arm_parameters.c", "-lm", "-o", f"{name}.so"]
        subprocess.run(command, cwd=folder, check=True)
        function = getattr(ctypes.CDLL(str(folder / f"{name}.so")), head[1])
        states = np.random.default_rng(0).uniform(-2.0, 2.0, (20, head[2].count("const "), 16))
        result = np.zeros((20, 4096))
        for given, out in zip(states, result, strict=True):
            function(*(pointer(row) for row in given), pointer(out))
        results.append(result)
    largest = float(np.abs(results[0]).max())
    return bool(np.abs(results[1] - results[0]).max() <= 1e-12 * largest)


def survivors(folder, chosen):
    """Build and run the self-test with each mutation; return those that it does not notice.

    Mutations that change no result are not counted.
    """
    found = []
    for mutation in chosen:
        path = folder / mutation.file
        text = path.read_text()
        lines = text.splitlines()
        assert lines[mutation.line] == mutation.before
        lines[mutation.line] = mutation.after
        path.write_text("\n".join(lines))
        sources = ["arm.c", "arm_parameters.c", "arm_test.c"]
        command = ["gcc", "-std=c99", "-O0", "-w", *sources, "-lm", "-o", "t"]
        try:
            built = subprocess.run(command, cwd=folder, check=False, stderr=subprocess.DEVNULL)
            if built.returncode == 0:
                done = subprocess.run([folder / "t"], stdout=subprocess.DEVNULL, check=False)
                if done.returncode == 0:
                    found.append(mutation)
        finally:
            path.write_text(text)
    return [str(mutation) for mutation in found if not same_function(folder, mutation)]


def all_mutations(folder):
    return [
        mutation
        for name in ("arm.c", "arm_parameters.c")
        for mutation in mutations(name, (folder / name).read_text())
    ]


def memory_arm():
    """Two joints, few statements, and every kind of memory."""
    return made_fit(lieid.robots.two_link(), "viscous,presliding:1,presliding/load:2")


@pytest.mark.slow
def test_self_test_notices_mutations(exported):
    folder = exported("memory", memory_arm)
    found = all_mutations(folder)
    assert len(found) > 1000
    chosen = random.Random(1).sample(found, 16)
    assert survivors(folder, chosen) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count"), [("rigid", 60), ("presliding", 150), ("sliding", 40), ("panda", 20)]
)
def test_self_test_notices_many_mutations(exported, name, count):
    folder = exported(name, ARMS[name])
    assert survivors(folder, random.Random(2).sample(all_mutations(folder), count)) == []


def test_a_value_that_is_not_finite_stays_the_worst(exported):
    """A NaN in one sample was overwritten by the next finite difference, and "ok" printed."""
    folder = exported("memory", memory_arm)
    text = (folder / "arm.c").read_text()
    start = text.index("void arm_gravity(")
    line = text.index("torque[1] = ", start)
    before = text[line : text.index("\n", line)]
    # finite in the last samples
    after = before.replace("= ", "= q[0] > -1e9 && q[1] < 0.5 ? 0.0 / 0.0 : ", 1)
    number = text[:line].count("\n")
    mutation = Mutation("arm.c", number, f"    {before}", f"    {after}")
    assert survivors(folder, [mutation]) == []
