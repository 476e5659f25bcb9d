"""Cases of the stages with a cutoff [X2]: support, images, fields and the truncation error."""

import support
from case import Table
from scene_cases import scene_case
from scenes import BY_ID
from truth import truth

WORDS = {
    "support": "The box of each primitive's support",
    "image-cutoff": "Images of primitives that end at the cutoff",
    "density-cutoff": "The density of primitives that end at the cutoff",
    "truncation-bound": "A bound on what the cutoff takes from each pixel",
}

# scene, cutoff, projection
SUPPORT = [
    ("cone-offset", 1e-3, "exact"), ("cone-offset", 1e-3, "affine"), ("parallel-offset", 1e-3, "exact"),
    ("gaussian-cone", 1e-5, "exact"), ("large-support", 1e-3, "exact"), ("large-support", 1e-3, "affine"),
    ("behind-source", 1e-3, "exact"), ("needle", 1e-3, "exact"), ("one-pixel", 1e-2, "exact"),
]
# For nu-3 the cutoff equals the value at a pixel's and at a voxel's distance, to ten digits.
IMAGE = [
    ("cone-offset", 1e-3, "exact"), ("cone-offset", 1e-3, "affine"), ("parallel-offset", 1e-2, "exact"),
    ("gaussian-cone", 1e-3, "exact"), ("large-support", 1e-3, "exact"), ("nu-3", 0.01391063957, "exact"),
]
VOLUME = [
    ("cone-offset", 1e-3), ("parallel-offset", 1e-2), ("gaussian-cone", 1e-3), ("large-support", 1e-3), ("nu-3", 0.1414207747),
]


def named(scene, projection):
    return scene if projection == "exact" else f"{scene}-{projection}"


def flags_for(name, stage):
    return ["on-the-cutoff"] if name == "nu-3" and stage != "support" else []


def cut(name, cutoff, projection="exact"):
    return support.Cut(truth(BY_ID[name]), cutoff, projection == "exact")


def supports():
    for name, cutoff, projection in SUPPORT:
        scene = BY_ID[name]

        def side(index, scene=scene, cutoff=cutoff, exact=projection == "exact"):
            view, number, which = index
            t = truth(scene)
            return support.box(t.primitives[number], t.scanner, t.views[view], cutoff, exact)[which]

        table = Table("box.npy", (len(scene.angles), len(scene.primitives), 4), side)
        yield scene_case("support", scene, projection, [table], name=named(name, projection), level="optional",
                         words=WORDS["support"], settings={"angles": scene.angles, "cutoff": cutoff, "projection": projection},
                         tags=["X2"])


def cut_images(stage):
    file = "image" if stage == "image-cutoff" else "bound"
    for name, cutoff, projection in IMAGE:
        scene, culled = BY_ID[name], cut(name, cutoff, projection)
        value, allowance = (culled.image, culled.image_allowance) if file == "image" else (culled.bound, culled.bound_allowance)
        shape = truth(scene).image_shape
        yield scene_case(stage, scene, projection, [Table(f"{file}.npy", shape, value)], name=named(name, projection),
                         level="optional", words=WORDS[stage], flags=flags_for(name, stage), tags=["X2"],
                         settings={"angles": scene.angles, "cutoff": cutoff, "projection": projection},
                         allowances={file: Table(f"{file}_allowance.npy", shape, allowance)})


def cut_densities():
    for name, cutoff in VOLUME:
        scene, culled = BY_ID[name], cut(name, cutoff)
        shape = scene.scanner.n_voxel
        yield scene_case("density-cutoff", scene, "density", [Table("volume.npy", shape, culled.volume)], level="optional",
                         words=WORDS["density-cutoff"], flags=flags_for(name, "density-cutoff"), tags=["X2"],
                         settings={"cutoff": cutoff},
                         allowances={"volume": Table("volume_allowance.npy", shape, culled.volume_allowance)})
