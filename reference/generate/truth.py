"""Every number of a scene on demand: images, fields and gradients, as mpmath numbers."""

import itertools
from functools import cache, cached_property

import numpy as np
from mpmath import mp, mpf

import density
import gradients
import projection
import scene
from files import pseudo_random

CLOSED_FORM_AGREEMENT = mpf(10)**-30


class Truth:
    def __init__(self, of):
        self.scene = of
        self.scanner, self.primitives = of.scanner, of.primitives
        self.image_shape = (len(of.angles), *of.scanner.n_detector)
        self.voxels = list(itertools.product(*map(range, of.scanner.n_voxel)))

    @cached_property
    def views(self):
        return [scene.view_at(self.scanner, angle) for angle in self.scene.angles]

    @cached_property
    def seen(self):
        """For each primitive, the views that do not leave it out."""
        return [[n for n, view in enumerate(self.views) if not projection.left_out(p, self.scanner, view)]
                for p in self.primitives]

    @cached_property
    def rays(self):
        return {(n, r, c): scene.ray(self.scanner, self.views[n], r, c)
                for n, r, c in itertools.product(*map(range, self.image_shape))}

    @cached_property
    def centres(self):
        return {index: self.scanner.voxel_centre(index) for index in self.voxels}

    @cached_property
    def parts(self):
        return [(p, scene.whitening(p), projection.gamma_ratio(p.nu)) for p in self.primitives]

    @cached_property
    def frames(self):
        """[primitive][view], None where it is left out."""
        return [[projection.CameraFrame(p, self.scanner, view) if n in seen else None for n, view in enumerate(self.views)]
                for p, seen in zip(self.primitives, self.seen)]

    @cached_property
    def d_image(self):
        return pseudo_random(f"{self.scene.id}/image", self.image_shape)

    @cached_property
    def d_volume(self):
        return pseudo_random(f"{self.scene.id}/volume", self.scanner.n_voxel)

    # ------------------------------------------------------------------------ contribution of one primitive to a pixel

    @cache
    def exact(self, number, pixel):
        """[X1] By quadrature; both closed forms are compared with it."""
        p, whiten, ratio = self.parts[number]
        frame = self.frames[number][pixel[0]]
        if frame is None:
            return mpf(0)
        value = projection.line_integral(p, whiten, *self.rays[pixel])
        for other in (projection.closed_form(p, whiten, *self.rays[pixel], ratio), frame.exact(*pixel[1:])):
            assert abs(other - value) <= CLOSED_FORM_AGREEMENT * abs(value), \
                f"{self.scene.id} {pixel}: {mp.nstr(other / value - 1, 3)}"
        return value

    def affine(self, number, pixel):
        """[Eq. 4] [Eq. 5]"""
        frame = self.frames[number][pixel[0]]
        return mpf(0) if frame is None else frame.affine(*pixel[1:])

    def image(self, contribution, pixel):
        total = mpf(0)
        for number in range(len(self.primitives)):
            total += contribution(number, pixel)
        return total

    def volume(self, voxel):
        """[Eq. 1]"""
        return sum(density.sample(p, whiten, self.centres[voxel]) for p, whiten, _ in self.parts)

    # ------------------------------------------------------------------------ <cotangent, contribution of one primitive>

    def pixels_of(self, number):
        return [i for i in self.rays if i[0] in self.seen[number]]

    def along_exact(self, number, p):
        whiten, ratio = scene.whitening(p), projection.gamma_ratio(p.nu)
        return mp.fsum(mpf(self.d_image[i]) * projection.closed_form(p, whiten, *self.rays[i], ratio)
                       for i in self.pixels_of(number))

    def along_affine(self, number, p):
        frames = {n: projection.CameraFrame(p, self.scanner, self.views[n]) for n in self.seen[number]}
        return mp.fsum(mpf(self.d_image[i]) * frames[i[0]].affine(*i[1:]) for i in self.pixels_of(number))

    def along_volume(self, number, p):
        whiten = scene.whitening(p)
        return mp.fsum(mpf(self.d_volume[i]) * density.sample(p, whiten, self.centres[i]) for i in self.voxels)

    def gradient(self, along, index):
        """Derivative of `along` to one number of one primitive; index as in a Table of `gradients.shapes`."""
        name, (number, *component) = index
        component = component[0] if component else None
        return gradients.difference(lambda p: along(number, p), self.primitives[number], name, component)


_TRUTHS = {}


def truth(of):
    """The Truth of a scene, shared by all cases so that no number is computed twice."""
    return _TRUTHS.setdefault(of.id, Truth(of))


def model_arrays(primitives):
    """The arrays of model.npz."""
    arrays = {name: np.zeros(shape) for name, shape in gradients.shapes(len(primitives)).items()}
    for number, p in enumerate(primitives):
        for name in gradients.PARAMETERS:
            value = getattr(p, name)
            arrays[name][number] = [float(x) for x in value] if isinstance(value, tuple) else float(value)
    return arrays


def meta_data(s):
    """meta_data.json in R2-Gaussian's form, whose offset along v counts upwards, towards +z."""
    low = [o - size / 2 for o, size in zip(s.off_origin, s.s_voxel)]
    high = [o + size / 2 for o, size in zip(s.off_origin, s.s_voxel)]
    assert max(s.s_voxel) == 2, "the scene scale must be 1"
    return {"scanner": {"mode": s.mode, "DSO": s.dso, "DSD": s.dsd, "nDetector": s.n_detector, "sDetector": s.s_detector,
                        "nVoxel": s.n_voxel, "sVoxel": s.s_voxel, "offOrigin": s.off_origin,
                        "offDetector": (s.off_detector[0], 0.0 - s.off_detector[1]), "totalAngle": 360.0, "startAngle": 0.0},
            "bbox": [low, high]}
