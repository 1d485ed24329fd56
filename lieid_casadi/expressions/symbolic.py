"""The model of an arm as named CasADi functions, for optimal control and code generation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.lie import Motion, Pose
from lieid_casadi.dynamics.regressor import regressor
from lieid_casadi.errors import ModelError
from lieid_casadi.expressions import forward_dynamics
from lieid_casadi.expressions.torque import FreeGroup, TorqueExpressions, Values, named_function
from lieid_casadi.model import Model
from lieid_casadi.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Frame:
    """The tool of ``robot``: an arm of so many ``joints`` up to the link with the frame."""

    robot: Robot
    joints: int

    @cached_property
    def forward_kinematics(self) -> ca.Function:
        """``q -> T`` (4, 4): homogeneous pose of the frame in the base frame."""
        q = ca.SX.sym("q", self.joints)
        pose = recursion.tool_in_base(self.robot, Motion.of(q[: self.robot.n]))
        return named_function("forward_kinematics", {"q": q}, {"T": homogeneous(pose)})

    @cached_property
    def jacobian(self) -> ca.Function:
        """``q -> J`` (6, n): twist [ω; v] of the frame's origin is J·dq, in axes of the base."""
        q = ca.SX.sym("q", self.joints)
        moving = closed_form.jacobian(self.robot, Motion.of(q[: self.robot.n]))
        still = ca.SX(6, self.joints - self.robot.n)
        return named_function("jacobian", {"q": q}, {"J": ca.horzcat(moving, still)})


def homogeneous(pose: Pose) -> ca.SX:
    """Return a pose as a matrix (4, 4)."""
    top = ca.horzcat(pose.rotation, pose.translation)
    return ca.densify(ca.vertcat(top, ca.SX(ca.DM([[0.0, 0.0, 0.0, 1.0]]))))


class SymbolicDynamics:
    """Named CasADi functions of one arm, built on first use; made by `lieid_casadi.symbolic`.

    Each attribute is a ``ca.Function`` and takes numbers, SX and MX. Vectors are columns; ``q``,
    ``dq``, ``ddq`` are in rad, rad/s, rad/s² (m for a sliding joint), ``tau`` in N·m (N). After
    the inputs that are stated below follow, where the model has them:

    ``states``
        States of effects with memory, in the order of ``model.states``.
    ``temperature``
        Joint temperatures (n,) in °C (for a model: relative to the mean of the recordings).
    ``time``
        Time in s since the start, for effects that warm up.
    ``payload``
        Ten link parameters of a body at the tool, in the tool frame.
    ``parameters``, ``effects``, ``shapes``
        Link parameters (10 n,), coefficients (m,) and shape parameters (s,) of a model.
    groups of parameters
        Those of ``free``, such as ``friction_3`` for ``friction:3``.

    The parts add up: ``tau = M·ddq + C·dq + gravity + friction``. Armature belongs to M; effects on
    the whole arm (payload, tilt, wrench) belong to M, C and gravity; friction holds all effects of
    single joints.
    """

    def __init__(
        self, torque: TorqueExpressions, *, allow_indefinite: bool, remedy: str = ""
    ) -> None:
        self._torque = torque
        self._allow_indefinite = allow_indefinite
        self._remedy = remedy

    @property
    def model(self) -> Model:
        """The model behind the functions."""
        return self._torque.model

    @property
    def free(self) -> dict[str, FreeGroup]:
        """Inputs of groups of parameters: labels and identified values (``nominal``) of each."""
        return dict(self._torque.values.free)

    def _function(
        self, name: str, leading: Sequence[str], outputs: dict[str, ca.SX]
    ) -> ca.Function:
        """Return a function of the named leading inputs and of those that the model adds."""
        symbols = self._torque.leading_symbols
        inputs = {key: symbols[key] for key in leading}
        return named_function(
            name, inputs | self._torque.further_inputs(static="dq" not in leading), outputs
        )

    @cached_property
    def inverse_dynamics(self) -> ca.Function:
        """``(q, dq, ddq) -> tau``: torque of the arm with all effects."""
        return self._function(
            "inverse_dynamics", ["q", "dq", "ddq"], {"tau": self._torque.inverse_dynamics}
        )

    @cached_property
    def mass_matrix(self) -> ca.Function:
        """``q -> M`` (n, n), symmetric; armature and payload included."""
        return self._function("mass_matrix", ["q"], {"M": self._torque.mass_matrix})

    @cached_property
    def link_mass_matrix(self) -> ca.Function:
        """``q -> M`` (n, n) of the links alone, without armature: that of `rigid_torque`."""
        return self._function("link_mass_matrix", ["q"], {"M": self._torque.link_mass_matrix})

    @cached_property
    def rigid_torque(self) -> ca.Function:
        """``(q, dq, ddq) -> tau`` of the links alone: the load of load-dependent friction."""
        leading = ["q", "dq", "ddq"]
        return self._function("rigid_torque", leading, {"tau": self._torque.rigid_torque})

    @cached_property
    def coriolis(self) -> ca.Function:
        """``(q, dq) -> C`` (n, n), with Ṁ − 2C skew-symmetric."""
        return self._function("coriolis", ["q", "dq"], {"C": self._torque.coriolis})

    @cached_property
    def gravity(self) -> ca.Function:
        """``q -> g`` (n,): torque at rest, effects on the whole arm included."""
        return self._function("gravity", ["q"], {"g": self._torque.gravity})

    @cached_property
    def friction(self) -> ca.Function:
        """``(q, dq[, load]) -> tau``: all effects of single joints except armature.

        ``load`` (n,) is `rigid_torque`; it is an input where friction depends on it.
        """
        leading = ["q", "dq", *(["load"] if self._torque.uses_load else [])]
        return self._function("friction", leading, {"tau": self._torque.friction})

    @cached_property
    def regressor(self) -> ca.Function:
        """``(q, dq, ddq) -> Y`` (n, 10 n): rigid torque per link parameter (Eq. 12)."""
        m = self._torque.motion
        matrix = regressor(self.model.robot, m)
        return named_function("regressor", {"q": m.q, "dq": m.dq, "ddq": m.ddq}, {"Y": matrix})

    @cached_property
    def base_regressor(self) -> ca.Function:
        """``(q, dq, ddq[, load]) -> Yb`` (n, p): torque per base parameter, effects included."""
        matrix = self._torque.base_regressor
        load = ca.which_depends(matrix, self._torque.load, 1, True)
        leading = ["q", "dq", "ddq", *(["load"] if any(load) else [])]
        return self._function("base_regressor", leading, {"Yb": matrix})

    @cached_property
    def forward_kinematics(self) -> ca.Function:
        """``q -> T`` (4, 4): pose of the tool in the base frame."""
        return self._tool.forward_kinematics

    @cached_property
    def jacobian(self) -> ca.Function:
        """``q -> J`` (6, n): twist [ω; v] of the tool's origin in base axes is J·dq."""
        return self._tool.jacobian

    @cached_property
    def _tool(self) -> Frame:
        return self.frame("tool")

    def frame(self, name: str) -> Frame:
        """Return the kinematics of a link frame.

        Parameters
        ----------
        name : str
            ``tool``, ``link1`` … ``linkn``, or the name of a joint or of its link.

        Raises
        ------
        ModelError
            If no frame has that name; the message lists those that exist.
        """
        robot = self.model.robot
        if name == "tool":
            return Frame(robot, robot.n)
        for i, joint in enumerate(robot.joints):
            if name in (f"link{i + 1}", joint.name, joint.link_name):
                part = replace(robot, joints=robot.joints[: i + 1], tool=np.eye(4), source=None)
                return Frame(part, robot.n)
        names = [joint.link_name or joint.name for joint in robot.joints]
        raise ModelError(
            f"robot {robot.name!r} has no frame {name!r}; expected tool, link1 … link{robot.n}, "
            f"or one of {', '.join(names)}"
        )

    @cached_property
    def forward_dynamics(self) -> ca.Function:
        """``(q, dq, tau) -> ddq``.

        The torque is affine in the acceleration for a given load; where friction depends on the
        load, Newton's method is unrolled (see `forward_dynamics.acceleration`). The Jacobian of
        the function is `forward_dynamics_derivatives` where CasADi calls it with MX.

        Raises
        ------
        ModelError
            If the mass matrix is not positive definite in a pose within the limits, or friction
            changes by more than the load that it depends on, so that no acceleration is determined.
        """
        self._require_solution()
        return named_function(
            "forward_dynamics", self._acceleration_inputs,
            {"ddq": forward_dynamics.acceleration(self._torque)},
            custom_jacobian=self._jacobian_function, jac_penalty=0,
        )  # fmt: skip

    @property
    def _acceleration_inputs(self) -> dict[str, ca.SX]:
        symbols = self._torque.leading_symbols
        return {key: symbols[key] for key in ("q", "dq", "tau")} | self._torque.further_inputs()

    @cached_property
    def forward_dynamics_derivatives(self) -> ca.Function:
        """``(q, dq, tau, ddq) -> ddq_q, ddq_dq, ddq_tau``, each (n, n), at a solution ``ddq``.

        By the implicit function theorem: −(∂ID/∂ddq)⁻¹·∂ID/∂q and so on, which takes fewer
        operations than the derivative of the solution. ``ddq`` is ``forward_dynamics(q, dq, tau)``.
        """
        symbols = self._torque.leading_symbols
        blocks = forward_dynamics.derivatives(self._torque, [symbols["q"], symbols["dq"]])
        outputs = dict(zip(("ddq_q", "ddq_dq", "ddq_tau"), blocks, strict=True))
        leading = ["q", "dq", "tau", "ddq"]
        return self._function("forward_dynamics_derivatives", leading, outputs)

    @cached_property
    def _jacobian_function(self) -> ca.Function:
        """The Jacobian of `forward_dynamics` in the form that CasADi expects."""
        inputs = self._acceleration_inputs
        ddq = self._torque.leading_symbols["ddq"]
        wanted = {name: symbol for name, symbol in inputs.items() if name != "tau"}
        blocks = forward_dynamics.derivatives(self._torque, list(wanted.values()))
        by_name = dict(zip([*wanted, "tau"], blocks, strict=True))
        return named_function(
            "jac_forward_dynamics", inputs | {"out_ddq": ddq},
            {f"jac_ddq_{name}": by_name[name] for name in inputs},
        )  # fmt: skip

    @cached_property
    def f_explicit(self) -> ca.Function:
        """``(x, u) -> xdot`` with x = [q; dq; states] and u = tau, as integrators and acados take.

        States of effects with memory follow their continuous-time equation.
        """
        self._require_solution()
        return forward_dynamics.explicit(self._torque)

    @cached_property
    def f_implicit(self) -> ca.Function:
        """``(x, xdot, u) -> residual``, zero along a motion; no matrix is inverted.

        The residual is [q̇ − dq; inverse_dynamics(q, dq, dq̇) − u; ṡ − rate of the states].
        """
        return forward_dynamics.implicit(self._torque)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the functions."""
        return (
            "inverse_dynamics", "forward_dynamics", "forward_dynamics_derivatives", "mass_matrix",
            "coriolis", "gravity", "friction", "regressor", "base_regressor",
            "forward_kinematics", "jacobian", "f_explicit", "f_implicit", "link_mass_matrix",
            "rigid_torque",
        )  # fmt: skip

    def _require_solution(self) -> None:
        """Refuse numbers whose acceleration is not determined within the limits."""
        if self._allow_indefinite:
            return
        reason = forward_dynamics.obstacle(self._torque, remedy=self._remedy)
        if reason:
            raise ModelError(f"{reason}, or pass allow_indefinite=True")

    def __repr__(self) -> str:
        """List the functions as their documentation states them, and the further inputs."""
        n, further = self.model.n, self._torque.further_inputs()
        lines = [f"SymbolicDynamics({self.model!r}), n = {n}"]
        for name in self.names:
            text = (getattr(type(self), name).__doc__ or "").strip().splitlines()[0]
            lines.append(f"  {name}: {text.replace('``', '').rstrip('.')}")
        if further:
            named = ", ".join(f"{name}[{symbol.numel()}]" for name, symbol in further.items())
            lines.append(f"  further inputs, where a function depends on them: {named}")
        return "\n".join(lines)

    def __getstate__(self) -> None:
        raise ModelError(
            "symbolic dynamics cannot be pickled; pickle the fit and call lieid.symbolic again, or "
            "save a function, such as inverse_dynamics.save('arm.casadi')"
        )


class FittedModel(Protocol):
    """What `symbolic` uses of a fit."""

    @property
    def model(self) -> Model:
        """The model that was fitted."""

    @property
    def link_parameters(self) -> Array:
        """Link parameters (10 n,)."""

    @property
    def effect_coefficients(self) -> Array:
        """Linear coefficients of the effects (m,)."""

    @property
    def shapes(self) -> Array:
        """Shape parameters (s,)."""

    @property
    def temperature_mean(self) -> Array | None:
        """Mean temperature (n,) of the training recordings, °C."""


def symbolic(
    source: Robot | Model | FittedModel,
    *,
    smooth_velocity: ArrayLike | None = None,
    as_measured: bool = False,
    free: Sequence[str] = (),
    allow_indefinite: bool = False,
) -> SymbolicDynamics:
    """Return the dynamics of an arm as named CasADi functions.

    Parameters
    ----------
    source : Robot, Model or Fit
        A robot: its nominal link parameters are numbers, there are no effects. A model: link
        parameters, effect coefficients and shape parameters are inputs. A fit: they are the
        fit's numbers.
    smooth_velocity : float or (n,), optional
        Half width w in rad/s (m/s) of the range in which sgn(q̇) is replaced by a polynomial of
        degree 7, three times continuously differentiable at ±w, so that derivatives are finite at
        rest, where its slope is 35/(16 w). Exported C takes the same width and has the same
        polynomial. None: sgn(q̇) itself, with sgn(0) = 0.
    as_measured : bool
        Whether the torque is what the sensor reads, with the model's measurement effects (gain,
        encoder offset), instead of what the drives deliver. The positions are then those that the
        encoders read. Effects on the whole arm (payload, tilt, wrench) are always included.
    free : sequence of str
        Groups of parameters that are inputs, each a vector of its own, such as ``["friction:3",
        "payload", "link6"]``: effects of single joints without armature (of joint 3, from 1), a
        body at the tool (ten link parameters in the tool frame), the ten parameters of a link, or
        an effect by its name. ``result.free`` has the labels and the identified values of each
        input. With a model all parameters are inputs, and ``payload`` alone may be added.
    allow_indefinite : bool
        Whether forward dynamics are given although the mass matrix is not positive definite in
        some poses within the joint limits.

    Returns
    -------
    SymbolicDynamics

    Raises
    ------
    RobotError
        Naming the links of a robot whose inertia is not stated.
    ModelError
        Neither a robot, a model nor a fit; a group of ``free`` that does not exist; a width of
        another length; or ``as_measured`` asks for an effect that cannot be evaluated at one
        instant (delay, elasticity).

    Examples
    --------
    >>> import lieid_casadi as lieid
    >>> arm = lieid.symbolic(lieid.robots.two_link())
    >>> arm.inverse_dynamics
    Function(inverse_dynamics:(q[2],dq[2],ddq[2])->(tau[2]) SXFunction)
    """
    if not isinstance(source, Robot | Model) and not hasattr(source, "effect_coefficients"):
        raise ModelError(
            f"got {source!r:.60}; expected a Robot, a Model or a Fit, such as "
            "lieid.Robot.load(path) or lieid.Fit.load(path)"
        )
    if isinstance(free, str):
        free = free.split(",")
    groups = [group.strip() for group in free if group.strip() != "payload"]
    payload = len(groups) < len(list(free))
    if isinstance(source, Robot):
        model = Model(source)
        values = Values.numbers(source.link_parameters, np.zeros(0), np.zeros(0))
    elif isinstance(source, Model):
        model, values = source, Values.symbols(source)
    else:
        model = source.model
        values = Values.numbers(
            source.link_parameters, source.effect_coefficients, source.shapes,
            source.temperature_mean,
        )  # fmt: skip
    if groups and not values.numeric:
        raise ModelError("free: all parameters are inputs already; expected a fit or a robot")
    if groups:
        values = values.with_free(model, groups)
    width = None
    if smooth_velocity is not None:
        width = np.asarray(smooth_velocity, dtype=float)
        if width.shape not in ((), (model.n,)):
            raise ModelError(f"smooth_velocity: shape {width.shape}; expected one or {model.n}")
        width = np.broadcast_to(width, (model.n,))
        if not (np.isfinite(width).all() and (width > 0.0).all()):
            raise ModelError(f"smooth_velocity: got {smooth_velocity}; expected rad/s above zero")
    torque = TorqueExpressions(model, values, width, as_measured=as_measured, payload=payload)
    remedy = "identify with --method feasible"
    if isinstance(source, Robot):
        remedy = "correct the inertias in the robot's description"
    return SymbolicDynamics(torque, allow_indefinite=allow_indefinite, remedy=remedy)
