"""The scenes: primitives, a scanner and views. Small, asymmetric, anisotropic, off-centre."""

from dataclasses import dataclass, field, replace
from math import inf

from mpmath import mpf

from scene import Scanner, primitive


@dataclass(frozen=True)
class Scene:
    id: str
    title: str
    scanner: Scanner
    angles: list
    primitives: list
    level: str = "core"         # core | optional | stress
    flags: list = field(default_factory=list)


CONE = Scanner("cone", dso=5.0, dsd=7.0, n_detector=(7, 9), s_detector=(3.5, 4.5),
               n_voxel=(5, 6, 7), s_voxel=(2.0, 2.0, 2.0))
OFFSET = Scanner("cone", dso=4.6, dsd=7.3, n_detector=(10, 8), s_detector=(3.9, 4.4),
                 n_voxel=(5, 7, 4), s_voxel=(2.0, 1.7, 1.2), off_origin=(0.13, -0.21, 0.07), off_detector=(0.35, -0.22))
PARALLEL = Scanner("parallel", dso=5.0, dsd=7.0, n_detector=(8, 10), s_detector=(1.9, 2.3),
                   n_voxel=(6, 5, 7), s_voxel=(1.8, 2.0, 1.5), off_origin=(-0.08, 0.05, 0.11), off_detector=(-0.17, 0.09))
WIDE = Scanner("cone", dso=5.0, dsd=7.0, n_detector=(8, 12), s_detector=(9.0, 13.0),
               n_voxel=(6, 5, 7), s_voxel=(2.0, 2.0, 2.0), off_detector=(0.4, 0.3))
# Every pixel centre below is a dyadic number, and so is the point on the axis that its ray meets.
DYADIC = Scanner("cone", dso=4.0, dsd=8.0, n_detector=(7, 9), s_detector=(1.75, 4.5),
                 n_voxel=(5, 6, 7), s_voxel=(2.0, 2.0, 2.0))


def student_body(nu):
    return primitive((0.23, -0.31, 0.17), (0.31, 0.18, 0.24), (0.83, -0.31, 0.42, 0.19), 0.7, nu)


def several(*nus):
    """Up to five primitives of different size and orientation, one per given nu."""
    shapes = [
        ((0.21, -0.34, 0.15), (0.27, 0.14, 0.19), (0.81, -0.33, 0.41, 0.26), 0.62),
        ((-0.45, 0.12, -0.38), (0.12, 0.33, 0.21), (0.35, 0.72, -0.18, 0.57), 0.35),
        ((0.52, 0.48, 0.29), (0.09, 0.16, 0.23), (-0.27, 0.44, 0.66, -0.54), 1.1),
        ((-0.18, -0.61, 0.44), (0.20, 0.08, 0.11), (0.95, 0.12, -0.07, 0.28), 0.48),
        ((0.08, 0.27, -0.09), (0.41, 0.36, 0.30), (0.10, -0.88, 0.23, 0.40), 0.09),
    ]
    return [primitive(*shape, nu) for shape, nu in zip(shapes, nus)]


def one_nu(name, nu, level, *flags):
    return Scene(f"nu-{name}", f"One primitive with nu = {name}, cone beam", CONE, [0.4, 2.7], [student_body(nu)],
                level, list(flags))


# In view 0 (angle 0, source at x = 5): depth 4.9, -0.8, exactly 0, and 0.045 where dso/100 is 0.05.
AROUND_SOURCE = [
    primitive((0.1, 0.2, -0.15), (0.27, 0.14, 0.19), (0.81, -0.33, 0.41, 0.26), 0.62, 4.5),
    primitive((5.8, 0.12, 0.3), (0.3, 0.2, 0.25), (0.35, 0.72, -0.18, 0.57), 0.35, 6.0),
    primitive((5.0, 0.25, -0.1), (0.2, 0.16, 0.23), (-0.27, 0.44, 0.66, -0.54), 0.5, 3.0),
    primitive((4.955, -0.02, 0.01), (0.2, 0.18, 0.11), (0.95, 0.12, -0.07, 0.28), 0.48, 9.0),
]

SCENES = [
    Scene("cone-centred", "Cone beam, centred detector, three Student-t primitives", CONE,
         [0.3, 2.2, 4.9], several(2.5, 7.25, 14.6)),
    Scene("cone-offset", "Cone beam, shifted non-square detector, shifted volume with three different voxel sides", OFFSET,
         [0.7, 2.9, 5.3], several(3.7, 2.2, 41.0, 9.5),
         flags=["offset-detector", "non-square-pixels", "offset-volume", "anisotropic-voxels"]),
    Scene("cone-five", "Cone beam, five overlapping primitives", CONE, [1.1, 3.8], several(2.1, 4.4, 11.0, 26.5, 88.0)),
    Scene("parallel-offset", "Parallel beam, shifted non-square detector, shifted volume", PARALLEL,
         [0.5, 1.6, 2.8], several(2.5, 7.25, 14.6),
         flags=["parallel", "offset-detector", "non-square-pixels", "offset-volume", "anisotropic-voxels"]),
    Scene("needle", "A needle 1:1000 that one pixel of each view hits", CONE, [0.9, 2.4],
         [primitive((0.0326, 0.2812, -0.0053), (0.5, 0.0005, 0.0006), (0.1079, 0.8708, 0.0144, -0.4794), 3.5, 3.3)],
         "stress", flags=["ill-conditioned"]),
    Scene("pancake", "A pancake 1:1000, edge-on for one pixel of view 0", CONE, [0.9, 2.4],
         [primitive((0.2772, -0.2258, 0.3575), (0.48, 0.0005, 0.41), (0.4985, -0.0528, 0.6938, 0.517), 5.5, 4.1)],
         "stress", flags=["ill-conditioned"]),
    one_nu("1", 1.0, "optional", "nu-below-training-range"),
    one_nu("2", 2.0, "core"),
    one_nu("3", 3.0, "core"),
    one_nu("30", 30.0, "core"),
    one_nu("1e3", 1e3, "optional", "nu-above-training-range"),
    one_nu("1e4", 1e4, "optional", "nu-above-training-range"),
    one_nu("1e6", 1e6, "optional", "nu-above-training-range", "gaussian-limit"),
    one_nu("inf", inf, "core", "gaussian-limit"),
    Scene("gaussian-cone", "Gaussian kernel, cone beam, shifted detector", OFFSET, [0.7, 2.9, 5.3],
         several(inf, inf, inf),
         flags=["offset-detector", "non-square-pixels", "offset-volume", "anisotropic-voxels"]),
    Scene("gaussian-parallel", "Gaussian kernel, parallel beam", PARALLEL, [0.5, 1.6], several(inf, inf, inf, inf),
         flags=["parallel", "offset-detector", "non-square-pixels", "offset-volume", "anisotropic-voxels"]),
    Scene("wide-student", "Wide detector: the far skirts of two Student-t primitives", WIDE, [0.2, 4.1],
         several(2.4, 17.0), "stress", flags=["far-skirt", "offset-detector", "non-square-pixels"]),
    Scene("wide-gaussian", "Wide detector: a Gaussian down to 1e-40 of its peak and less", WIDE, [0.2, 4.1],
         [primitive((0.26, -0.38, 0.21), (0.26, 0.21, 0.3), (0.77, 0.31, -0.44, 0.2), 0.9, inf)], "stress",
         ["far-skirt", "offset-detector", "non-square-pixels"]),
    Scene("pixel-centre", "A centre that projects exactly on the centre of pixel (1, 6) of view 0", DYADIC, [0.0, 1.3],
         [primitive((0.0, 0.5, 0.25), (0.22, 0.31, 0.15), (0.7, 0.2, -0.5, 0.4), 0.8, 5.2)], flags=["centre-on-pixel"]),
    Scene("quaternion-norm", "Quaternions of norm 0.001, 250 and 1, one of them with w = 0", CONE, [0.6, 3.3],
         [primitive((0.3, -0.2, 0.12), (0.32, 0.12, 0.2), (0.0007, -0.0003, 0.0005, 0.0004), 0.6, 6.5),
          primitive((-0.33, 0.25, -0.2), (0.15, 0.3, 0.11), (-120.0, 95.0, 160.0, -115.0), 0.5, 2.9),
          primitive((0.05, 0.42, 0.33), (0.1, 0.21, 0.28), (0.0, 0.6, -0.8, 0.0), 0.4, 12.0)],
         flags=["unnormalised-quaternion"]),
    Scene("outside-view", "Centres that project beside the detector; the image has their skirts only",
         Scanner("cone", dso=5.0, dsd=7.0, n_detector=(7, 9), s_detector=(0.8, 1.1), n_voxel=(5, 6, 7),
                 s_voxel=(2.0, 2.0, 2.0), off_detector=(0.1, -0.05)),
         [0.3, 0.5],
         [primitive((0.15, 0.85, 0.1), (0.28, 0.17, 0.22), (0.9, 0.2, -0.3, 0.25), 0.8, 3.1),
          primitive((-0.2, 0.12, -0.9), (0.14, 0.25, 0.31), (0.4, -0.6, 0.5, 0.48), 0.55, 8.7)],
         flags=["centre-outside-detector"]),
    Scene("faint", "Densities 0 and 1e-30 beside an ordinary one", CONE, [0.3, 2.2],
         [replace(p, density=mpf(density)) for p, density in zip(several(2.5, 7.25, 14.6), (0.0, 1e-30, 1.1))],
         flags=["zero-density", "tiny-density"]),
    Scene("subnormal", "Densities of 1e-310: every value is a subnormal number", CONE, [0.3],
         [replace(p, density=mpf(1e-310)) for p in several(2.5, 7.25)], "stress", ["subnormal"]),
    Scene("behind-source",
         "One primitive in front of the source; one behind it, one at its plane, one just inside of the near limit",
         CONE, [0.0], AROUND_SOURCE, "optional", ["behind-source", "at-source-plane", "near-limit"]),
    Scene("behind-source-turned", "The same primitives from two sides: what view 0 leaves out, view 1 sees",
         CONE, [0.0, 1.3], AROUND_SOURCE, "optional", ["behind-source", "at-source-plane", "near-limit"]),
    Scene("large-support",
         "Supports within the detector, larger than it, around the source, and beside it but across its plane: no ellipse",
         Scanner("cone", dso=5.0, dsd=7.0, n_detector=(6, 7), s_detector=(2.4, 3.1), n_voxel=(5, 4, 3), s_voxel=(2.0, 1.6, 1.2)),
         [0.8, 2.5],
         [primitive((0.1, -0.15, 0.05), (0.05, 0.03, 0.04), (0.9, 0.2, -0.3, 0.25), 2.1, 11.0),
          primitive((0.2, 0.11, -0.3), (0.33, 0.26, 0.41), (0.4, -0.6, 0.5, 0.48), 0.3, 3.2),
          primitive((-0.12, 0.07, 0.2), (0.72, 0.81, 0.77), (0.83, -0.31, 0.42, 0.19), 0.2, 2.1),
          primitive((0.1, 0.2, -0.1), (0.78, 0.1, 0.12), (0.81, 0.02, -0.03, 0.58), 0.4, 2.2)],
         "optional", ["support-beyond-detector", "support-not-ellipse"]),
    Scene("one-pixel", "A detector of one pixel and a volume of one voxel",
         Scanner("cone", dso=5.0, dsd=7.0, n_detector=(1, 1), s_detector=(0.5, 0.4), n_voxel=(1, 1, 1), s_voxel=(2.0, 2.0, 2.0),
                 off_origin=(0.05, -0.1, 0.02), off_detector=(0.12, -0.07)),
         [0.3, 2.2], several(2.5, 7.25), flags=["one-pixel"]),
    Scene("odd-even", "A detector with an odd and an even side, and a volume too",
         Scanner("cone", dso=5.5, dsd=8.0, n_detector=(5, 6), s_detector=(3.1, 3.4), n_voxel=(4, 3, 2), s_voxel=(2.0, 1.8, 1.3)),
         [3.3], several(2.5, 7.25, 14.6), flags=["odd-even-sides", "non-square-pixels", "anisotropic-voxels"]),
    Scene("parallel-small", "Parallel beam on a small shifted detector with an even and an odd side",
         Scanner("parallel", dso=5.0, dsd=7.0, n_detector=(4, 5), s_detector=(1.9, 2.2), n_voxel=(2, 3, 4), s_voxel=(1.6, 2.0, 1.1),
                 off_origin=(0.05, -0.03, 0.08), off_detector=(0.13, -0.06)),
         [0.9, 2.1], several(3.7, 2.2, 41.0),
         flags=["parallel", "odd-even-sides", "offset-detector", "non-square-pixels", "offset-volume", "anisotropic-voxels"]),
    Scene("tiny-quaternion", "A quaternion of norm 1e-18", CONE, [0.6],
         [primitive((0.3, -0.2, 0.12), (0.32, 0.12, 0.2), (0.7e-18, -0.3e-18, 0.5e-18, 0.4e-18), 0.6, 6.5)],
         "optional", ["unnormalised-quaternion", "tiny-quaternion"]),
    Scene("tinier-quaternion", "A quaternion of norm 1e-100", CONE, [0.6],
         [primitive((0.3, -0.2, 0.12), (0.32, 0.12, 0.2), (0.7e-100, -0.3e-100, 0.5e-100, 0.4e-100), 0.6, 6.5)],
         "stress", ["unnormalised-quaternion", "tiny-quaternion"]),
]

BY_ID = {scene.id: scene for scene in SCENES}
