"""Events that vpptwin wrote, run in mjlab: `python draw_events.py robot.xml events.py`.

Needs mjlab 1.6, in an environment of its own as it pins another MuJoCo than vpptwin, and no GPU.
Prints what each event drew over 512 environments beside its range, and how far the robots are apart after a second of
the same commands; ends with code 1 if a number lies outside its range, or all are alike where they should differ.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import mujoco
import torch
from mjlab.entity import EntityCfg
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab.scene import SceneCfg
from mjlab.sim import MujocoCfg, SimulationCfg

COUNT = 512
FIELDS = {
    "joint_friction": "dof_frictionloss", "joint_damping": "dof_damping", "joint_armature": "dof_armature",
    "joint_stiffness": "jnt_stiffness", "body_mass": "body_mass", "body_com_offset": "body_ipos",
}  # fmt: skip
"""Function of an event → the field of MuJoCo that it draws."""


def make_env(robot: Path, events: Path) -> ManagerBasedRlEnv:
    """The robot COUNT times, with the events and nothing else; actuators as its MJCF has them."""
    model = mujoco.MjModel.from_xml_path(str(robot))
    entity = EntityCfg(spec_fn=lambda: mujoco.MjSpec.from_file(str(robot)))
    cfg = ManagerBasedRlEnvCfg(
        scene=SceneCfg(entities={"robot": entity}, num_envs=COUNT),
        sim=SimulationCfg(mujoco=MujocoCfg(timestep=model.opt.timestep)), decimation=1, episode_length_s=1e9,
    )  # fmt: skip
    cfg.events |= runpy.run_path(str(events))["randomize"]("robot")
    return ManagerBasedRlEnv(cfg, device="cpu")


def tell_draws(env: ManagerBasedRlEnv, events: Path) -> bool:
    """Print what every event drew; whether all lie within their ranges and fill them."""
    good = True
    for term, event in runpy.run_path(str(events))["randomize"]("robot").items():
        field, ranges = FIELDS[event.func.__name__], event.params["ranges"]
        which = event.params["asset_cfg"]
        robot, indexing = env.scene["robot"], env.scene["robot"].indexing
        if which.joint_names:
            ids = robot.find_joints(which.joint_names)[0]
            rows = (indexing.joint_ids if field == "jnt_stiffness" else indexing.joint_v_adr)[ids]
        else:
            rows = indexing.body_ids[robot.find_bodies(which.body_names)[0]]
        drawn = getattr(env.sim.model, field)[:, rows].reshape(COUNT, -1)
        for axis, (low, high) in (ranges if isinstance(ranges, dict) else {0: ranges}).items():
            least, most = float(drawn[:, axis].min()), float(drawn[:, axis].max())
            loose = 1e-6 * max(abs(low), abs(high))
            good &= low - loose <= least and most <= high + loose and most - least >= 0.9 * (high - low) - loose
            print(f"{term} {axis}: {least:.6g} to {most:.6g}, range {low:.6g} to {high:.6g}")
    return good


def main() -> int:
    """Draw, step, tell."""
    robot, events = map(Path, sys.argv[1:])
    env = make_env(robot, events)
    env.reset()
    good = tell_draws(env, events)
    generator = torch.Generator().manual_seed(1)
    steps = round(1.0 / env.physics_dt)
    low, high = env.sim.model.actuator_ctrlrange[0].T if env.sim.mj_model.nu else (torch.zeros(0),) * 2
    for step in range(steps):
        if step % max(steps // 10, 1) == 0:
            command = low + (high - low) * torch.rand(len(low), generator=generator)
        env.sim.data.ctrl[:] = command
        env.sim.step()
    places = env.sim.data.qpos[:]
    spread = (places.max(dim=0).values - places.min(dim=0).values).tolist()
    print("after 1 s of one command for all, positions lie apart by", " ".join(f"{value:.3g}" for value in spread))
    return 0 if good and torch.isfinite(places).all() else 1


if __name__ == "__main__":
    sys.exit(main())
