"""Cases of related methods: FDK, noise, random numbers, metrics."""

from functools import cache

import numpy as np
from mpmath import mp, mpf

import chacha
import fdk
import metrics
import noise
from case import Case, Given, Table
from files import pseudo_random
from scene import Scanner
from truth import meta_data


def short(array):
    """Rounded to 20 binary places, so that float32 holds the numbers exactly."""
    return np.round(np.asarray(array) * 2.0**20) / 2.0**20


def uniform(key, shape):
    return short(pseudo_random(key, shape) / 2 + 0.5)


# ---------------------------------------------------------------------------- FDK

CONE = Scanner("cone", dso=4.6, dsd=7.3, n_detector=(6, 7), s_detector=(3.9, 4.4), n_voxel=(5, 4, 3), s_voxel=(2.0, 1.7, 1.2),
               off_origin=(0.13, -0.21, 0.07), off_detector=(0.35, -0.22))
PARALLEL = Scanner("parallel", dso=5.0, dsd=7.0, n_detector=(5, 8), s_detector=(1.9, 2.3), n_voxel=(4, 5, 3),
                   s_voxel=(1.8, 2.0, 1.5), off_origin=(-0.08, 0.05, 0.11), off_detector=(-0.17, 0.09))
WIDE = Scanner("cone", dso=5.0, dsd=7.0, n_detector=(1, 33), s_detector=(0.4, 4.9), n_voxel=(4, 4, 1), s_voxel=(2.0, 2.0, 0.2))
SMALL = Scanner("cone", dso=5.0, dsd=7.0, n_detector=(4, 5), s_detector=(0.8, 1.1), n_voxel=(5, 4, 6), s_voxel=(2.0, 1.8, 1.9))
EVEN, UNEVEN = [0.3 + 1.25 * k for k in range(5)], [5.9, 0.2, 1.9, 2.3, 4.4]
SHIFTED = ["offset-detector", "non-square-pixels", "offset-volume", "anisotropic-voxels"]

# name, title, scanner, angles, windows, flags. The case of the first window has the plain name and a backprojection.
SCANS = [
    ("cone", "cone beam, shifted detector, uneven views out of order", CONE, UNEVEN,
     ["ram-lak", "shepp-logan", "cosine", "hamming", "hann"], [*SHIFTED, "uneven-views"]),
    ("even", "cone beam, even views", CONE, EVEN, ["ram-lak"], SHIFTED),
    ("parallel", "parallel beam, uneven views, two of them nearly opposite", PARALLEL, [0.4, 1.1, 1.3, 2.6, 0.4 + 3.25],
     ["ram-lak", "hann"], ["parallel", *SHIFTED, "uneven-views"]),
    ("one-view", "a single view stands for the whole turn", CONE, [1.2], ["ram-lak"], [*SHIFTED, "one-view"]),
    ("long-row", "a row of 33 pixels, padded to 128", WIDE, [0.5, 3.1], ["hamming"], ["one-row", "non-square-pixels"]),
    ("beyond-detector", "most voxels project beside the detector", SMALL, [0.2, 2.2, 4.5], ["ram-lak"],
     ["non-square-pixels", "beyond-detector"]),
]


def scans():
    """(name, title, scanner, angles, window, flags, projections, the sums, the stored filtered projections)"""
    for name, title, scanner, angles, windows, flags in SCANS:
        projections = uniform(f"fdk/{name}", (len(angles), *scanner.n_detector)) * 2
        for window in windows:
            id = name if window == windows[0] else f"{name}-{window}"
            yield id, name, title, scanner, angles, window, flags, projections


def fdk_case(stage, scan, given, table, settings):
    id, folder, title, scanner, angles, window, flags, _ = scan
    what = {"fdk-filter": "Weighted and filtered projections", "fdk": "FDK", "fdk-backprojection": "Backprojection"}[stage]
    inputs = {**given, "scanner": Given(f"inputs/fdk-{folder}/meta_data.json", meta_data(scanner))}
    window_title = f", {window} window" if "window" in settings else ""
    return Case(stage, id, f"{what}: {title}{window_title}", [], inputs, {table.file.split(".")[0]: table}, "optional",
                flags, {"angles": angles, **settings})


def projections_of(scan):
    return {"projections": Given(f"inputs/fdk-{scan[1]}/projections.npy", scan[-1])}


def fdk_filters():
    for scan in scans():
        _, _, _, scanner, angles, window, _, projections = scan
        sums = fdk.Fdk(scanner, angles, window, projections)
        yield fdk_case("fdk-filter", scan, projections_of(scan), Table("filtered.npy", projections.shape, sums.filtered),
                       {"window": window, "padding": fdk.padding(scanner.n_detector[1])})


def fdk_backprojections():
    for scan in scans():
        id, folder, _, scanner, angles, _, _, projections = scan
        if id != folder or folder == "even":
            continue
        filtered = short(pseudo_random(f"fdk/{folder}/filtered", projections.shape))
        read = lambda n, r, c, filtered=filtered: mpf(float(filtered[n, r, c]))
        table = Table("volume.npy", scanner.n_voxel,
                      lambda i, scan=scan, read=read: fdk.backprojection(scan[3], scan[4], read, i))
        yield fdk_case("fdk-backprojection", scan, {"filtered": Given(f"inputs/fdk-{folder}/filtered.npy", filtered)}, table, {})


def fdks():
    for scan in scans():
        _, _, _, scanner, angles, window, _, projections = scan
        filtered = cache(fdk.Fdk(scanner, angles, window, projections).filtered)
        read = lambda n, r, c, filtered=filtered: filtered((n, r, c))
        table = Table("volume.npy", scanner.n_voxel,
                      lambda i, scan=scan, read=read: fdk.backprojection(scan[3], scan[4], read, i))
        yield fdk_case("fdk", scan, projections_of(scan), table,
                       {"window": window, "padding": fdk.padding(scanner.n_detector[1])})


# ---------------------------------------------------------------------------- noise

FLOOR = 0.5


def draws(name, projections, photons):
    """Counts like Poisson draws (integers near their expectation), and numbers like normal draws."""
    peak = mpf(float(projections.max()))
    spread, normals = (sum(pseudo_random(f"noise/{name}/{key}/{k}", projections.shape) for k in range(3))
                       for key in ("counts", "normals"))
    counts = np.zeros(projections.shape)
    for i in np.ndindex(*projections.shape):
        mean = noise.expected(mpf(float(projections[i])), peak, photons) if peak > 0 else mpf(photons)
        counts[i] = float(max(0, mp.nint(mean + mp.sqrt(mean) * mpf(float(spread[i])))))
    return counts, short(normals)


def noises():
    shape = (2, 4, 5)
    for name, title, photons, sigma, flags in [
            ("low", "1e5 photons, sigma 10", 1e5, 10.0, []), ("medium", "5e4 photons, sigma 20", 5e4, 20.0, []),
            ("high", "1e4 photons, sigma 40", 1e4, 40.0, []), ("no-electronics", "sigma 0", 1e3, 0.0, []),
            ("starved", "five photons: readings below the floor and above I0", 5.0, 3.0, ["below-floor", "above-i0"]),
            ("no-object", "projections of zeros stay zeros", 1e4, 40.0, ["zero-image"])]:
        projections = np.zeros(shape) if name == "no-object" else 3 * uniform(f"noise/{name}", shape)
        counts, normals = draws(name, projections, photons)
        given = {"projections": projections, "counts": counts, "normals": normals}
        peak = projections.max()
        table = Table("noisy.npy", shape, lambda i, peak=peak, counts=counts, normals=normals, photons=photons, sigma=sigma:
                      noise.noisy(peak, counts[i], normals[i], photons, sigma, FLOOR))
        yield Case("noise", name, f"Noise from given draws: {title}", [],
                   {key: Given(f"inputs/noise-{name}/{key}.npy", array) for key, array in given.items()},
                   {"noisy": table}, "optional", flags, {"photons": photons, "sigma": sigma, "floor": FLOOR})


# ---------------------------------------------------------------------------- random numbers

ADDRESSES = [
    ("zero", "seed 0, the first pixel's noise", (0, 1, 0, 0), 32), ("ordinary", "an ordinary address", (42, 2, 17, 1234), 32),
    ("purpose-3", "another purpose", (42, 3, 17, 1234), 16), ("purpose-4", "another purpose and step", (42, 4, 30000, 0), 16),
    ("purpose-5", "another purpose and seed", (7, 5, 0, 1), 16),
    ("large", "seed, step and id beyond 32 bits, three blocks", (2**53 - 1, 6, 2**40 + 12345, 2**52 + 7), 48),
]


def randoms():
    for name, title, address, count in ADDRESSES:
        tables = {"words": Table("words.npy", (count,), lambda i, address=address: chacha.word(*address, i[0])),
                  "uniform": Table("uniform.npy", (count // 2,), lambda i, address=address: chacha.uniform(*address, i[0]))}
        settings = dict(zip(("seed", "purpose", "step", "id"), address), count=count)
        yield Case("random", name, f"Random words and numbers: {title}", [], {}, tables, "optional", [], settings)


# ---------------------------------------------------------------------------- metrics

def measured(name):
    """volume_truth, volume, projections_truth, projections"""
    volume, stack = uniform(f"metrics/{name}/volume", (5, 6, 7)), 4 * uniform(f"metrics/{name}/projections", (3, 6, 8))
    volume_result = volume + short(0.05 * pseudo_random(f"metrics/{name}/volume-error", volume.shape))
    stack_result = stack + short(0.2 * pseudo_random(f"metrics/{name}/projections-error", stack.shape))
    if name == "zero-slices":
        volume[:2] = volume[:, :, -1] = 0.0
        stack[1] = 0.0
    if name == "zero-result":
        volume_result[:] = 0.0
        stack_result[2] = 0.0
    if name == "negative":
        volume_result[1] -= 1.0
        stack_result[0] -= 5.0
    if name == "equal":
        volume_result, stack_result = volume, stack
    return volume, volume_result, stack, stack_result


def metric_cases():
    for name, title, flags in [
            ("ordinary", "a result with small errors", []),
            ("zero-slices", "slices and a view whose truth is zero are left out", ["zero-image"]),
            ("zero-result", "a volume of zeros, and a view of zeros, which is not scaled", ["zero-image"]),
            ("negative", "negative values, and a view that is nowhere above 0", ["negative-values"]),
            ("equal", "equal data: infinite PSNR", ["equal-pixels"])]:
        arrays = dict(zip(("volume_truth", "volume", "projections_truth", "projections"), measured(name)))
        functions = {key: cache(lambda function=function, pair=pair: function(*pair)) for key, function, pair in [
            ("psnr_3d", metrics.psnr_3d, (arrays["volume_truth"], arrays["volume"])),
            ("ssim_3d", metrics.ssim_3d, (arrays["volume_truth"], arrays["volume"])),
            ("psnr_2d", metrics.psnr_2d, (arrays["projections_truth"], arrays["projections"])),
            ("ssim_2d", metrics.ssim_2d, (arrays["projections_truth"], arrays["projections"]))]}
        table = Table("metrics.npz", {key: (1,) for key in functions}, lambda i, functions=functions: functions[i[0]]())
        yield Case("metrics", name, f"PSNR and SSIM: {title}", [],
                   {key: Given(f"inputs/metrics-{name}/{key}.npy", array) for key, array in arrays.items()},
                   {"metrics": table}, "optional", flags)
