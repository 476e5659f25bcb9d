"""Cases of the stages that take a scene: fields, images and their gradients."""

import projection
import scene as s
from case import Case, Given, Table, higher, lowered
from gradients import shapes
from scenes import BY_ID, SCENES
from truth import meta_data, model_arrays, truth

WORDS = {
    "covariance": "Covariance matrices",
    "density": "The density at voxel centres",
    "projected-kernel-affine": "Affine images of each primitive alone",
    "projected-kernel-exact": "Line integrals of each primitive alone",
    "image-affine": "Affine images",
    "image-exact": "Line integrals",
    "gradient-density": "Gradient through the density",
    "gradient-image-affine": "Gradient through the affine images",
    "gradient-image-exact": "Gradient through the line integrals",
}
EQUATIONS = {
    "covariance": ["Eq. 3"],
    "density": ["Eq. 1", "Eq. 2", "Eq. 3"],
    "affine": ["Eq. 1", "Eq. 2", "Eq. 3", "Eq. 4", "Eq. 5"],
    "exact": ["Eq. 1", "Eq. 2", "Eq. 3", "Eq. 4", "Eq. 5", "X1"],
}
PROJECTED = ["cone-centred", "parallel-small", "odd-even", "nu-inf", "pixel-centre", "behind-source", "one-pixel"]
COVARIANCE = ["cone-five", "gaussian-cone", "quaternion-norm", "needle", "pancake", "tiny-quaternion", "tinier-quaternion"]
NO_IMAGE_GRADIENT = ["subnormal"]


def equations(scene, family):
    """[Eq. 2] and [Eq. 5] do not cover a Gaussian; [X3] concerns a large nu."""
    tags = EQUATIONS[family]
    if scene.primitives[0].gaussian:
        return [tag for tag in tags if tag not in ("Eq. 2", "Eq. 5")]
    return tags + ["X3"] * (family != "covariance" and max(p.nu for p in scene.primitives) >= 1000)


def model(scene):
    return Given(f"inputs/{scene.id}/model.npz", model_arrays(scene.primitives))


def scanner(scene):
    return Given(f"inputs/{scene.id}/meta_data.json", meta_data(scene.scanner))


def cotangent(scene, kind):
    array = truth(scene).d_image if kind == "image" else truth(scene).d_volume
    return Given(f"inputs/{scene.id}/cotangent_{kind}.npy", array)


def scene_case(stage, scene, family, outputs, *, name=None, level="core", settings=None, allowances=None, more=None,
               words=None, flags=(), tags=()):
    """A case whose level, flags and title come from its scene."""
    inputs = {"model": model(scene), "scanner": scanner(scene), **(more or {})}
    return Case(stage, name or scene.id, f"{words or WORDS[stage]}: {lowered(scene.title)}",
                equations(scene, family) + list(tags), inputs, {table.file.split(".")[0]: table for table in outputs},
                higher(level, scene.level), scene.flags + list(flags), settings or {}, allowances or {})


def covariances():
    for scene in (BY_ID[name] for name in COVARIANCE):
        def entry(index, scene=scene):
            number, i, j = index
            return s.covariance(scene.primitives[number])[i][j]

        made = scene_case("covariance", scene, "covariance", [Table("covariance.npy", (len(scene.primitives), 3, 3), entry)])
        del made.inputs["scanner"]
        yield made


def densities():
    for scene in SCENES:
        table = Table("volume.npy", scene.scanner.n_voxel, lambda i, scene=scene: truth(scene).volume(i))
        yield scene_case("density", scene, "density", [table])


def contribution(scene, kind):
    return truth(scene).exact if kind == "exact" else truth(scene).affine


def projected_kernels(kind):
    for scene in (BY_ID[name] for name in PROJECTED):
        table = Table("kernels.npy", (len(scene.primitives), *truth(scene).image_shape),
                      lambda i, scene=scene: contribution(scene, kind)(i[0], i[1:]))
        yield scene_case(f"projected-kernel-{kind}", scene, kind, [table], settings={"angles": scene.angles})


def images(kind):
    for scene in SCENES:
        table = Table("image.npy", truth(scene).image_shape,
                      lambda i, scene=scene: truth(scene).image(contribution(scene, kind), i))
        yield scene_case(f"image-{kind}", scene, kind, [table], settings={"angles": scene.angles})


def density_gradients():
    for scene in SCENES:
        t = truth(scene)
        table = Table("grad.npz", shapes(len(scene.primitives)), lambda i, t=t: t.gradient(t.along_volume, i))
        yield scene_case("gradient-density", scene, "density", [table], more={"cotangent": cotangent(scene, "volume")})


def image_gradients(kind):
    for scene in SCENES:
        if scene.id in NO_IMAGE_GRADIENT:
            continue
        t = truth(scene)
        along = t.along_exact if kind == "exact" else t.along_affine
        table = Table("grad.npz", shapes(len(scene.primitives)), lambda i, t=t, along=along: t.gradient(along, i))
        yield scene_case(f"gradient-image-{kind}", scene, kind, [table], settings={"angles": scene.angles},
                         more={"cotangent": cotangent(scene, "image")})
