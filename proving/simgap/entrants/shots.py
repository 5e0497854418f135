"""Entrants that fit simulations to motion: one cause at a time, CMA-ES over all, and `mujoco.sysid`."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from proving.simgap.entrants.corrections import STEP, Correction, find_dof, kind_of
from proving.simgap.entrants.fits import draw_sizes
from proving.simgap.entrants.lab import Lab
from proving.simgap.session import HISTORY, HORIZONS

SPAN = 4.0
"""Typical sizes within which a size is searched, to either side."""
POSITIVE = ("coulomb", "stiction", "viscous", "drag", "spring", "delay", "lag", "backlash", "load", "payload")
NOT = ("cogging", "dead_band")
"""Kinds that need numbers beside the size, or that the common simulator lacks."""


def measure(lab: Lab, corrections: list[Correction], few: int = 12) -> float:
    """Mean squared error of stretches, in variances of the motion; a simulation that fails counts as 100."""
    stretches = lab.tried[:: max(len(lab.tried) // few, 1)]
    measured = np.stack([s.measured for s in stretches if s.measured is not None])
    error = (measured - lab.predict(stretches, corrections)) / np.array(list(lab.session.scales.values()))
    return float(np.mean(np.where(np.isfinite(error), np.clip(error, -10.0, 10.0), 10.0) ** 2))


def bound(lab: Lab, cause: str) -> tuple[float, float]:
    """Where a size is searched."""
    given, kind = lab.session.causes[cause], kind_of(cause)
    if kind in ("saturation", "rate_limit", "force_limit"):
        return 0.05 * given.off, given.off
    low = given.off if kind in POSITIVE else given.off - SPAN * given.scale
    if kind in ("gain", "stiffness"):
        low = max(low, 0.1)
    if kind == "mass":
        low = max(low, -0.8 * float(lab.model.body(Correction(cause, 0.0).place).mass[0]))
    return low, given.off + SPAN * given.scale


def rank(lab: Lab) -> tuple[dict[str, float], dict[str, list[float]], list[Correction]]:
    """Each cause alone, its size by Brent's method on the error of stretches; evidence is n_eff / 2 log ratio."""
    plain = measure(lab, [])
    stretches = len(lab.tried[:: max(len(lab.tried) // 12, 1)])
    count = stretches * len(HORIZONS) * len(lab.session.predicted) / 5.0  # neighbouring horizons say much the same
    evidence, sizes, best = {}, {}, (0.0, Correction("", 0.0))
    rng = np.random.default_rng(0)
    for cause in lab.session.causes:
        if kind_of(cause) in NOT:
            continue
        rest = {"other": spring_rest(lab, cause)} if kind_of(cause) in ("spring", "stiction") else {}
        low, high = bound(lab, cause)

        def error(size: float, cause: str = cause, rest: dict[str, float] = rest) -> float:
            return measure(lab, [Correction(cause, size, **rest)])

        found = minimize_scalar(
            error, bounds=(low, high), method="bounded", options={"maxiter": 10, "xatol": 0.02 * (high - low)}
        )
        evidence[cause] = 0.5 * count * float(np.log(plain / max(found.fun, 1e-12)))
        h = 0.05 * (high - low)
        curve = (error(found.x + h) + error(found.x - h) - 2.0 * found.fun) / h**2
        std = float(np.sqrt(2.0 * found.fun / max(count * curve, 1e-12))) if curve > 0.0 else h
        sizes[cause] = draw_sizes(rng, float(found.x), min(std, 0.5 * (high - low)))
        if evidence[cause] > best[0]:
            best = evidence[cause], Correction(cause, float(found.x), **rest)
    return evidence, sizes, [best[1]] if best[1].cause else []


def spring_rest(lab: Lab, cause: str) -> float:
    """Where a spring rests: the mean position; of breakaway friction, a tenth of the rms speed."""
    j = find_dof(lab.model, Correction(cause, 0.0).place)
    if kind_of(cause) == "stiction":
        return 0.1 * float(np.sqrt(np.mean(np.concatenate([m.v[:, j] for m in lab.motions]) ** 2)))
    return float(np.mean(np.concatenate([m.q[:, j] for m in lab.motions])))


PACE = ("inertia", "viscous", "coulomb", "offset", "delay")
"""What PACE fits of every joint: armature, damping, friction, encoder's zero, and one delay."""


def evolve(lab: Lab, evaluations: int = 600) -> tuple[dict[str, float], dict[str, list[float]], list[Correction]]:
    """CMA-ES over armature, damping, dry friction and zero of all joints and delays, as PACE does it.

    Evidence is the change in typical sizes, squared; sizes are as spread as the last population.
    """
    import cma

    names = [c for c in lab.session.causes if kind_of(c) in PACE]
    if not names:
        return {}, {}, []
    causes = [lab.session.causes[name] for name in names]
    spans = np.array([bound(lab, name) for name in names])
    off, scale = np.array([c.off for c in causes]), np.array([c.scale for c in causes])
    low, high = ((spans - off[:, None]) / scale[:, None]).T

    def read(x: np.ndarray) -> list[Correction]:
        return [Correction(n, float(o + s * v)) for n, o, s, v in zip(names, off, scale, x)]

    options = {"maxfevals": evaluations, "bounds": [low.tolist(), high.tolist()], "seed": 1, "verbose": -9}
    search = cma.CMAEvolutionStrategy(np.clip(np.full(len(names), 0.05), low, high), 0.5, options)
    while not search.stop():
        population = search.ask()
        search.tell(population, [measure(lab, read(x)) for x in population])
    best = np.asarray(search.result.xbest)
    spread = np.std(np.asarray(search.ask(20)), axis=0)
    rng, plain = np.random.default_rng(0), measure(lab, [])
    gain = 1.0 - search.result.fbest / max(plain, 1e-12)
    evidence = {name: float(x**2) * max(gain, 0.0) for name, x in zip(names, best)}
    sizes = {
        n: draw_sizes(rng, float(o + s * x), float(s * e)) for n, o, s, x, e in zip(names, off, scale, best, spread)
    }
    return evidence, sizes, read(best)


def identify(lab: Lab) -> tuple[dict[str, float], dict[str, list[float]], list[Correction]]:
    """`mujoco.sysid`: armature, damping, friction, gain and masses; evidence is half a squared standard score."""
    import io
    from contextlib import redirect_stdout

    import mujoco
    from absl import logging
    from mujoco import sysid

    logging.set_verbosity(logging.ERROR)
    spec = mujoco.MjSpec.from_string(lab.session.model)
    spec.option.timestep = STEP
    model, found, names = spec.compile(), sysid.ParameterDict(), []
    for cause, given in lab.session.causes.items():
        kind, place = kind_of(cause), Correction(cause, 0.0).place
        if kind not in ("coulomb", "viscous", "inertia", "gain", "mass") or "+" in place:
            continue
        low, high = bound(lab, cause)
        names.append(cause)
        found.add(sysid.Parameter(cause, given.off, low, high, modifier=make_modifier(spec, kind, place)))
    if not names or lab.free:  # its signals of a free joint are not tried
        return {}, {}, []
    starts, controls, measured = [], [], []
    columns = [(f"{model.joint(j).name}_qpos", sysid.SignalType.MjStateQPos) for _, j in lab.positions]
    for stretch in lab.tried[:: max(len(lab.tried) // 12, 1)]:
        u = stretch.u[round((HISTORY - stretch.lead) / STEP) :]
        clock = STEP * np.arange(len(u))
        controls.append(sysid.TimeSeries.from_control_names(clock, u, model))
        starts.append(sysid.create_initial_state(model, stretch.q, stretch.v))
        measured.append(
            sysid.TimeSeries.from_names(np.array(HORIZONS) + stretch.lead - 1e-4, stretch.measured, model, columns)
        )
    scale = np.array(list(lab.session.scales.values()))

    def weigh(params, predicted, truth, model, return_all, state, **_):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN003, ANN202
        moved = np.stack(
            [np.interp(truth.times, state[:, 0], state[:, 1 + i]) for i in range(truth.data.shape[1])], axis=1
        )
        return (moved - truth.data) / scale, truth, truth

    group = sysid.ModelSequences(
        "rig", spec, [f"w{i}" for i in range(len(starts))], starts, controls, measured, allow_missing_sensors=True
    )
    residual = sysid.build_residual_fn(models_sequences=[group], modify_residual=weigh, n_threads=1)
    with redirect_stdout(io.StringIO()):
        fitted, result = sysid.optimize(
            found.copy().move_off_bounds(), residual, verbose=False, max_iters=8, x_scale="jac"
        )
    misses, _, _ = residual(result.x, fitted)
    covariance, _ = sysid.calculate_intervals([np.ravel(m) for m in misses], result.jac)
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300)) * np.sqrt(5.0)
    rng, values, evidence, sizes = np.random.default_rng(0), fitted.as_vector(), {}, {}
    for name, value, error in zip(names, values, std):
        off = lab.session.causes[name].off
        least = 1e-6 * lab.session.causes[name].scale
        score = (value - off) / max(error, least) if np.isfinite(error) else 0.0
        evidence[name] = 0.5 * float(score) ** 2
        sizes[name] = draw_sizes(rng, float(value), float(error) if np.isfinite(error) else 0.0)
    told = [Correction(name, float(value)) for name, value in zip(names, values) if evidence[name] > 2.0]
    return evidence, sizes, told


def make_modifier(spec, kind: str, place: str):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """What a parameter of a kind changes in the model: from nominal values, as sysid changes the same model again."""
    if kind == "mass":
        mass, inertia = spec.body(place).mass, np.array(spec.body(place).inertia)
    elif kind == "gain":
        gear = np.array(spec.actuator(place).gear)
    else:
        name = {"coulomb": "frictionloss", "viscous": "damping", "inertia": "armature"}[kind]
        nominal = np.ravel(getattr(spec.joint(place), name)).copy()  # damping is a polynomial of speed

    def modify(spec, parameter) -> None:  # type: ignore[no-untyped-def]  # noqa: ANN001
        value = float(parameter.value[0])
        if kind == "mass":
            spec.body(place).mass, spec.body(place).inertia = mass + value, inertia * (1.0 + value / mass)
        elif kind == "gain":
            spec.actuator(place).gear = gear * value
        else:
            now = np.array([max(nominal[0] + value, 0.0), *nominal[1:]])
            setattr(spec.joint(place), name, float(now[0]) if len(now) == 1 else now)

    return modify
