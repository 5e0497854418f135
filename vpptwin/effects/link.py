"""Effects on what a base holds: masses of links and where they are, a payload on the last one, a tilted mount."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from vpptwin.effects.base import Effect, Stage
from vpptwin.effects.body import AXES, move_centre
from vpptwin.effects.constants import Constants, Site
from vpptwin.effects.joint import JOINT_SHOWS
from vpptwin.effects.parameter import Parameter, Prior

LOOK_ALIKES = ("bias", "spring", "offset")
"""Effects of a link's hinge that its weight looks like when it pulls elsewhere."""


@dataclass(frozen=True)
class Link:
    """A moving body that effects are made for."""

    name: str  # in the MJCF
    mass: float  # kg
    # where a payload is looked for first, in the body's frame [m]; None where none is
    tip: tuple[float, float, float] | None = None
    reach: float = 0.1  # half of how far the body gets from its joint [m]
    ways: str = ""  # axes of the body along which it shows where its centre of mass is, such as "xz"
    lever: float = 0.1  # at which its weight is what typically drives its hinge [m]
    hinge: str = ""  # that turns it
    load: float = 0.0  # that the joints may carry there, by the mass of the whole arm and what drives it [kg]
    span: float = 0.1  # half of how far the longest body of the arm gets from its joint [m]
    room: float = 1.0  # factor on bounds of masses


def apply_mass(constants: Constants, site: Site, /, mass: np.ndarray) -> None:
    """Mass added to that of a link, spread as its own is [kg]."""
    # I' = I (m + Δm)/m: density grows, shape stays.
    nominal = constants["body_mass"][:, site.body]
    constants["body_inertia"][:, site.body] *= (1.0 + mass / nominal)[:, None]
    nominal += mass


def apply_payload(
    constants: Constants, site: Site, /, mass: np.ndarray, place_x: np.ndarray, place_y: np.ndarray, place_z: np.ndarray
) -> None:
    """A point mass on a link: mass, centre of mass and inertia follow, so that they are those of a body."""
    # c' = c + m_p/(m + m_p) r, I' = I + m m_p/(m + m_p) (|r|² 1 - r rᵀ), r from the old centre to the point (Steiner).
    rows, body = np.flatnonzero(mass), site.body
    fields = [constants[name] for name in ("body_mass", "body_ipos", "body_iquat", "body_inertia")]
    nominal, centre, turn, moments = (field[rows, body] for field in fields)
    away, share = np.stack([place_x, place_y, place_z], axis=1)[rows] - centre, mass[rows] / (nominal + mass[rows])
    axes = to_matrix(turn)
    square = (away**2).sum(axis=1)[:, None, None] * np.eye(3) - away[:, :, None] * away[:, None, :]
    inertia = (axes * moments[:, None, :]) @ axes.swapaxes(1, 2) + (nominal * share)[:, None, None] * square
    principal, vectors = np.linalg.eigh(inertia)
    vectors[:, :, 2] *= np.sign(np.linalg.det(vectors))[:, None]
    for field, values in zip(
        fields, (nominal + mass[rows], centre + share[:, None] * away, to_attitude(vectors), principal)
    ):
        field[rows, body] = values


def to_matrix(attitude: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    w, x, y, z = attitude.T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.array(rows).transpose(2, 0, 1)


def to_attitude(matrix: np.ndarray) -> np.ndarray:
    """Unit quaternions (n, 4) of rotation matrices (n, 3, 3): an eigenvector of Bar-Itzhack's matrix (2000)."""
    m = matrix.transpose(1, 2, 0)
    x, y, z = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    a, b, c = m[0, 0], m[1, 1], m[2, 2]
    rows = ((a + b + c, x, y, z), (x, a - b - c, xy, xz), (y, xy, b - a - c, yz), (z, xz, yz, c - a - b))
    attitude = np.linalg.eigh(np.array(rows).transpose(2, 0, 1))[1][:, :, -1]
    return attitude * np.where(attitude[:, :1] < 0.0, -1.0, 1.0)


def apply_tilt(constants: Constants, site: Site, /, x: np.ndarray, y: np.ndarray) -> None:
    """The mount turned by the rotation vector (x, y, 0), so that gravity comes from elsewhere [rad]."""
    # g' = g cos φ - (u × g) sin φ + u (u·g)(1 - cos φ) with φ u = (x, y, 0), turned back (Rodrigues).
    angle, gravity = np.hypot(x, y), constants["opt.gravity"]
    axis = np.stack([x, y, 0.0 * x], axis=1) / np.maximum(angle, 1e-300)[:, None]
    sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
    along = axis * (axis * gravity).sum(axis=1, keepdims=True)
    gravity += (cosine - 1.0) * (gravity - along) - sine * np.cross(axis, gravity)


def effects_for_links(links: Iterable[Link]) -> tuple[Effect, ...]:
    """`NAME.mass` of every link, `NAME.com` where it shows, `NAME.payload` of those that may carry one."""
    found: list[Effect] = []
    for link in links:
        source, size = "assumption: shares of what the model has", 0.05 * link.mass
        mass = Parameter(
            name="mass", unit="kg", off=0.0, low=-0.8 * link.mass, high=link.room * max(4.0 * link.mass, link.load),
            size=size, tolerance=0.05 * size, prior=Prior("normal", 0.0, 2.0 * size), source=source,
        )  # fmt: skip
        kinds = ("mass", *(("com",) if link.ways else ()), *(("payload",) if link.tip else ()))
        alike = {kind: tuple(f"{link.name}.{other}" for other in kinds if other != kind) for kind in kinds}
        found.append(Effect(
            f"{link.name}.mass", f"a wrong mass of {link.name}", "(m, I) × (1 + mass/m)", (mass,), Stage.CONSTANT,
            apply_mass, JOINT_SHOWS, alike["mass"], ("body_mass", "body_inertia"), link.name, follows="position",
        ))  # fmt: skip
        if link.ways:
            found.append(displace(link, alike["com"]))
        if link.tip is None:
            continue
        held = Parameter(
            name="mass", unit="kg", off=0.0, low=0.0, high=link.room * max(10.0 * link.mass, link.load), size=size,
            tolerance=0.05 * size, prior=Prior("halfnormal", 0.0, 4.0 * size), source=source,
        )  # fmt: skip
        far = 2.0 * max(link.reach, link.span)  # a tool may be longer than what holds it
        place = tuple(
            Parameter(name=f"place_{axis}", unit="m", off=at, low=at - far, high=at + far,
                      size=0.3 * link.reach, tolerance=4.0 * far, prior=Prior("normal", at, 0.3 * link.reach),
                      source="assumption: at the far end of the link")
            for axis, at in zip(AXES, link.tip)
        )  # fmt: skip
        found.append(Effect(
            f"{link.name}.payload", f"a payload on {link.name}",
            "a point mass at (place_x, place_y, place_z)", (held, *place), Stage.CONSTANT,
            apply_payload, JOINT_SHOWS, alike["payload"], ("body_mass", "body_ipos", "body_iquat", "body_inertia"),
            link.name, follows="position",
        ))  # fmt: skip
    return tuple(found)


def displace(link: Link, alike: tuple[str, ...]) -> Effect:
    """`NAME.com` of a link: mass, and inertia about its centre, stay as they are."""
    size = 0.05 * link.lever
    parameters = tuple(
        Parameter(name=axis, unit="m", off=0.0, low=-link.reach, high=link.reach, size=size, tolerance=0.05 * size,
                  prior=Prior("normal", 0.0, 1.5 * size), source="assumption: shares of what drives its hinge")
        for axis in link.ways
    )  # fmt: skip
    return Effect(
        f"{link.name}.com", f"a wrong centre of mass of {link.name}",
        f"c + ({', '.join(axis if axis in link.ways else '0' for axis in AXES)})", parameters, Stage.CONSTANT,
        move_centre(link.ways), JOINT_SHOWS, alike, target=link.name, follows="position",
    )  # fmt: skip


MOUNT_TILT = Effect(
    id="mount.tilt", summary="a mount that is not level", equation="gravity turned back by (x, y, 0)",
    parameters=tuple(
        Parameter(name=axis, unit="rad", off=0.0, low=-0.5, high=0.5, prior=Prior("normal", 0.0, 0.02), size=0.02,
                  tolerance=0.002, source="assumption: levelled by hand to a degree")
        for axis in AXES[:2]
    ),
    stage=Stage.CONSTANT, apply=apply_tilt, shows=JOINT_SHOWS, writes=("opt.gravity",), follows="position",
)  # fmt: skip
