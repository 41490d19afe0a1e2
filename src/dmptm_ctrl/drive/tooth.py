"""Mesh stiffness from the tooth's shape (Eq. 22) and mesh damping (Eq. 24).

    1/k = ∫ x² / (E J(x)) dx,   J(x) = b s(x)³/12,   x from the point of load to the base

The tooth is a cantilever with the force on the pitch circle. Eq. 22 knows bending alone;
shear, compression, the foundation and the contact are as large together, so it is several
times too stiff. They can be added, and then agree with ISO 6336-1.

Numbers that are not positive and finite are refused with a ValueError.
"""

from collections.abc import Callable
from math import acos, cos, pi, sin, sqrt, tan
from typing import NamedTuple

from scipy.integrate import quad

from dmptm_ctrl.drive.parameters import positive

STEEL_YOUNG = 2.06e11  # Pa, ISO 6336-1
STEEL_POISSON = 0.3
DEDENDUM = 1.25  # of the module, ISO 53 profile A
SHEAR_FACTOR = 1.2  # of a rectangular section


class Tooth(NamedTuple):
    """A spur-gear tooth of the standard basic rack."""

    module: float  # m
    teeth: float
    face_width: float  # m
    young: float = STEEL_YOUNG  # Pa
    poisson: float = STEEL_POISSON
    pressure_angle: float = pi / 9  # rad, 20°

    def check(self) -> None:
        """Refuse a tooth with a number that is not positive and finite."""
        positive(**self._asdict())

    @property
    def pitch_radius(self) -> float:
        """Radius of the pitch circle [m]."""
        return 0.5 * self.module * self.teeth

    @property
    def root_radius(self) -> float:
        """Radius of the root circle, the tooth's base [m]."""
        return self.pitch_radius - DEDENDUM * self.module

    def half_angle(self, radius: float) -> float:
        """Half of the tooth's angle at a radius [rad]; radial flank below the base circle."""
        base = self.pitch_radius * cos(self.pressure_angle)
        local = acos(min(base / radius, 1.0))
        return pi / (2.0 * self.teeth) + _involute(self.pressure_angle) - _involute(local)

    def section(self, radius: float) -> tuple[float, float]:
        """Height on the tooth's axis and thickness [m] of the chord at a flank radius."""
        angle = self.half_angle(radius)
        return radius * cos(angle), 2.0 * radius * sin(angle)


def _involute(angle: float) -> float:
    return tan(angle) - angle


def cantilever_stiffness(
    thickness: Callable[[float], float],
    length: float,
    width: float,
    young: float,
    *,
    as_printed: bool = False,
) -> float:
    """Return the bending stiffness [N/m] of a cantilever with a force at its end, Eq. 22.

    `thickness` s(x) [m] is at distance x [m] from the **point of load**; `length`, `width` in m,
    `young` in Pa. `as_printed` has x from the base and the polar moment, as Eq. 22 prints it.
    """

    def corrected(x: float) -> float:
        return x**2 / (young * width * thickness(x) ** 3 / 12.0)

    def printed(x: float) -> float:
        s = thickness(length - x)
        return x**2 / (young * width * s * (s**2 + width**2) / 12.0)

    return 1.0 / quad(printed if as_printed else corrected, 0.0, length, epsrel=1e-10)[0]


def tooth_stiffness(tooth: Tooth) -> float:
    """Return the stiffness of one tooth by Eq. 22 [N/m], force and deflection circumferential."""
    tooth.check()
    top = tooth.section(tooth.pitch_radius)[0]
    root = tooth.section(tooth.root_radius)[0]

    def thickness(x: float) -> float:
        return tooth.section(_radius_at(tooth, top - x))[1]

    return cantilever_stiffness(thickness, top - root, tooth.face_width, tooth.young)


def _radius_at(tooth: Tooth, height: float) -> float:
    """Flank radius [m] of the chord at a height on the tooth's axis, by Newton's method."""
    radius = height
    for _ in range(3):  # the chord's angle varies slowly: each pass gains two digits
        radius = height / cos(tooth.half_angle(max(radius, tooth.root_radius)))
    return radius


def pair_stiffness(one: Tooth, other: Tooth, *, complete: bool = False) -> float:
    """Return the stiffness of one pair of teeth in mesh at the pitch point [N/m].

    By Eq. 22 for both teeth in series, circumferential; `complete` along the line of action, with
    shear, compression, foundation (Cornell, J. Mech. Des. 103 (1981) 447, after Weber) and contact
    (Yang & Sun, J. Mech. Trans. Autom. 107 (1985) 529). ValueError for teeth of different module,
    pressure angle or face width.
    """
    for name in ("module", "pressure_angle", "face_width"):
        if getattr(one, name) != getattr(other, name):
            raise ValueError(f"teeth of different {name} do not mesh")
    one.check()
    other.check()
    if not complete:
        return 1.0 / (1.0 / tooth_stiffness(one) + 1.0 / tooth_stiffness(other))
    contact = sum(2.0 * (1.0 - t.poisson**2) / (pi * t.young * t.face_width) for t in (one, other))
    return 1.0 / (_compliance(one) + _compliance(other) + contact)


def _compliance(t: Tooth) -> float:
    """Compliance [m/N] of a tooth and its foundation along the line of action."""
    top, chord = t.section(t.pitch_radius)
    root, base = t.section(t.root_radius)
    angle = t.pressure_angle - t.half_angle(t.pitch_radius)  # of the force, to the chord
    shear_modulus = t.young / (2.0 * (1.0 + t.poisson))

    def beam(x: float) -> float:
        s = t.section(_radius_at(t, top - x))[1]
        area = t.face_width * s
        moment = cos(angle) * x - sin(angle) * chord / 2.0
        return (
            moment**2 / (t.young * t.face_width * s**3 / 12.0)
            + SHEAR_FACTOR * cos(angle) ** 2 / (shear_modulus * area)
            + sin(angle) ** 2 / (t.young * area)
        )

    lever = (top - root - tan(angle) * chord / 2.0) / base
    v = t.poisson
    foundation = (1.0 - v**2) * (
        5.306 * lever**2
        + 2.0 * (1.0 - v - 2.0 * v**2) / (1.0 - v**2) * lever
        + 1.534 * (1.0 + 0.4167 * tan(angle) ** 2 / (1.0 + v))
    )
    foundation *= cos(angle) ** 2 / (t.young * t.face_width)
    return quad(beam, 0.0, top - root, epsrel=1e-10)[0] + foundation


def iso_single_stiffness(teeth_1: float, teeth_2: float, face_width: float) -> float:
    """Return the single stiffness c'th b [N/m] of steel spur teeth without profile shift.

    `teeth_1`, `teeth_2` are z1 and z2, `face_width` in m. ISO 6336-1, method B:
    q' = 0.04723 + 0.15551/z1 + 0.25791/z2 [mm·µm/N]; the standard multiplies by 0.8 (C_M) to meet
    measurements.
    """
    positive(teeth_1=teeth_1, teeth_2=teeth_2, face_width=face_width)
    flexibility = 0.04723 + 0.15551 / teeth_1 + 0.25791 / teeth_2  # mm·µm/N
    return 1e9 / flexibility * face_width  # 1 N/(mm·µm) is 1e9 N/m per metre


def mesh_torsion(stiffness: float, pitch_radius: float) -> float:
    """Return the torsional stiffness [N·m/rad] at a pinion from the circumferential one [N/m].

    `pitch_radius` [m] is the pinion's.
    """
    positive(stiffness=stiffness, pitch_radius=pitch_radius)
    return stiffness * pitch_radius**2


def mesh_damping(ratio: float, stiffness: float, pinion: float, ring: float, n2: float) -> float:
    """Return the mesh damping c [N·m·s/rad] at the pinion for a damping ratio ζ, Eq. 24 put right.

    The paper takes a `ratio` of 0.03 to 0.17. `stiffness` is in N·m/rad, `pinion` J̄3 and `ring`
    J_L in kg·m², `n2` is z_L/z_3.
    """
    positive(ratio=ratio, stiffness=stiffness, pinion=pinion, ring=ring, n2=n2)
    reduced = pinion * ring / (ring + n2**2 * pinion)  # inertia seen at the pinion
    return 2.0 * ratio * sqrt(stiffness * reduced)


def mesh_damping_ratio(
    damping: float, stiffness: float, pinion: float, ring: float, n2: float
) -> float:
    """Return the damping ratio ζ of a mesh damping c, the inverse of :func:`mesh_damping`."""
    positive(damping=damping)
    return damping / mesh_damping(1.0, stiffness, pinion, ring, n2)


def mesh_damping_as_printed(
    ratio: float, stiffness: float, pinion: float, ring: float, r3: float, r_ring: float
) -> float:
    """Return Eq. 24 as printed, in N·m²·s/rad for k in N·m/rad: it changes with the unit of R.

    `r3`, `r_ring` are pitch radii [m], inertias `pinion`, `ring` in kg·m².
    """
    positive(ratio=ratio, stiffness=stiffness, pinion=pinion, ring=ring, r3=r3, r_ring=r_ring)
    reduced = r3**2 * r_ring**2 * pinion * ring / (r3**2 * pinion + r_ring**2 * ring)
    return 2.0 * ratio * sqrt(stiffness * reduced)
