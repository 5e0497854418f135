"""What evolves of effects on joints and bodies, run alone along a motion that was measured, without any force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from vpptwin.effects import Effect, Stage
from vpptwin.twin.stepping.kernel import FLY, compile_once
from vpptwin.twin.stepping.pipeline import Pipeline, write_pipeline

ADDRESSES = (
    "parameters", "rest", "qpos", "qvel", "time", "first", "stops", "lead_qpos", "lead_qvel", "lead_rest", "active",
    "dry", "inertia", "recalled", "states",
)  # fmt: skip
TRACK = np.dtype(
    [
        *((name, np.int64) for name in ADDRESSES),
        ("samples", np.int64),
        ("marks", np.int64),
        ("lead", np.int64),
        ("dt", float),
    ]
)
"""Addresses of the arrays of `Recollection.run`, and their sizes."""

RECALL = """
def recall_effects(address, begin, end, room):
    track = array_at(address, (1,), TRACK)[0]
    rest = array_at(track.rest, (track.samples, {states}), np.float64)
    qpos = array_at(track.qpos, (track.samples, {nq}), np.float64)
    qvel = array_at(track.qvel, (track.samples, {nv}), np.float64)
    time, first = array_at(track.time, (track.samples,), np.float64), array_at(track.first, (track.samples,), np.bool_)
    stops, active = array_at(track.stops, (track.marks,), np.int64), array_at(track.active, ({places},), np.bool_)
    dry, inertia = array_at(track.dry, ({nv},), np.float64), array_at(track.inertia, ({nC},), np.float64)
    lead_rest = array_at(track.lead_rest, (track.marks, {states}), np.float64)
    scratch = array_at(room, (4, {nv}), np.float64)
    for i in range(begin, end):
        parameters = array_at(track.parameters + {parameters} * 8 * i, ({parameters},), np.float64)
        states = array_at(track.states + {states} * 8 * i, ({states},), np.float64)
        recalled = array_at(track.recalled + track.marks * {states} * 8 * i, (track.marks, {states}), np.float64)
        mark = 0
        for k in range(track.samples):
            if first[k]:
                for j in range({states}):
                    states[j] = rest[k, j]
            while mark < track.marks and stops[mark] == k:
                own = recalled[mark]
                for j in range({states}):
                    own[j] = states[j]
                at = track.lead_qpos + (track.lead + 1) * {nq} * 8 * mark
                lead_qpos = array_at(at, (track.lead, {nq}), np.float64)
                at = track.lead_qvel + (track.lead + 1) * {nv} * 8 * mark
                lead_qvel = array_at(at, (track.lead, {nv}), np.float64)
                for n in range(track.lead):
                    seen = PastStep(time[k] + n * track.dt, track.dt, lead_qpos[n], lead_qvel[n], inertia)
                    recall(active, parameters, own, dry, seen, scratch)
                for j in range({states}):
                    own[j] -= lead_rest[mark, j]
                mark += 1
            seen = PastStep(time[k], track.dt, qpos[k], qvel[k], inertia)
            recall(active, parameters, states, dry, seen, scratch)
"""


class Past(NamedTuple):
    """How flights moved, one after the other, sampled every step of the twin."""

    time: np.ndarray  # (T,) s on each flight's clock
    qpos: np.ndarray  # the engine's positions, (T, nq)
    qvel: np.ndarray  # (T, nv)
    first: np.ndarray  # where a flight begins, (T,) bool
    stops: np.ndarray  # the samples from which the leads of windows go on, (K,)
    # positions from there to the start of each window, (K, L + 1, nq): what is known of them there
    lead_qpos: np.ndarray
    lead_qvel: np.ndarray  # velocities, (K, L + 1, nv)


def evolves(effect: Effect) -> bool:
    """Whether an effect has what goes on evolving along a motion that is known: on the craft and on rotors none has."""
    return bool(effect.states) and effect.stage is not Stage.THRUST and effect.target != ""


@dataclass(frozen=True)
class Recollection:
    """The effects of a model that evolve, ready to be run along what is known of the past."""

    pipeline: Pipeline  # the whole step's, to whose columns, switches and states the text keeps
    source: str  # text of the C function, and of the effects in it
    dry: np.ndarray  # friction that the joints have without any effect, (nv,)
    inertia: np.ndarray  # joint-space inertia in the reference pose, (nC,): few effects ask for it, and roughly
    dt: float  # step [s]

    def run(self, parameters: np.ndarray, active: np.ndarray, past: Past) -> np.ndarray:
        """How far the effects' states are from those at rest with the joints where the windows start.

        Every flight begins at rest. What the effects exert does not matter: the motion is known. What loads a joint is
        not, and counts as nothing.

        Args:
            parameters: of N simulations, (N, P).
            active: switches, (E,).
            past: the flights.

        Returns:
            (N, K, S), in the order of the windows.
        """
        count = len(parameters)
        order = np.argsort(past.stops, kind="stable")
        rest = self.pipeline.start_effects(past.qpos, past.qvel)
        lead_rest = self.pipeline.start_effects(past.lead_qpos[order, -1], past.lead_qvel[order, -1])
        recalled = np.zeros((count, len(order), rest.shape[1]))
        arrays = {
            "parameters": parameters, "rest": rest, "qpos": past.qpos, "qvel": past.qvel, "time": past.time,
            "first": past.first, "stops": past.stops[order].astype(np.int64), "lead_qpos": past.lead_qpos[order],
            "lead_qvel": past.lead_qvel[order], "lead_rest": lead_rest, "active": active, "dry": self.dry,
            "inertia": self.inertia, "recalled": recalled, "states": np.zeros((count, rest.shape[1])),
        }  # fmt: skip
        held = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        track, room = np.zeros((), TRACK), np.zeros((4, len(self.dry)))
        for name, array in held.items():
            track[name] = array.ctypes.data
        track["samples"], track["marks"], track["dt"] = len(past.time), len(order), self.dt
        track["lead"] = past.lead_qpos.shape[1] - 1
        run = compile_once(self.source, "recall_effects", self.pipeline, {"TRACK": TRACK}, FLY)
        run(track.ctypes.data, 0, count, room.ctypes.data)
        result = np.empty_like(recalled)
        result[:, order] = recalled
        return result


def write_recollection(
    model: mujoco.MjModel, pipeline: Pipeline, catalogue: Sequence[Effect], dry: np.ndarray
) -> Recollection:
    """What runs the effects that evolve on a model's joints and bodies.

    Args:
        model: of the twin.
        pipeline: of the whole catalogue.
        catalogue: its effects.
        dry: friction that the joints have without any effect, (nv,).
    """
    evolving = [e for e in catalogue if evolves(e)]
    rubbing = {e.target for e in evolving if e.stage is Stage.SLIP}
    wanted = [e.id for e in catalogue if evolves(e) or (e.stage is Stage.FRICTION and rubbing & {*e.places})]
    part = write_pipeline(model, catalogue, frozenset(wanted))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    text = RECALL.format(
        states=len(pipeline.starts), places=len(pipeline.places), parameters=len(pipeline.columns), nq=int(model.nq),
        nv=int(model.nv), nC=int(model.nC),
    )  # fmt: skip
    return Recollection(part, text, dry, np.array(data.M), float(model.opt.timestep))
