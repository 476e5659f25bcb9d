"""trgs against RTK in one run on one machine: time of projecting, FDK and a pass of SART, and the quality of FDK.

    pip install itk-rtk numpy
    cargo build --release
    python benches/peers/rtk.py --size 256 --views 18 --threads 2

Both get the same exact projections of an ellipsoid phantom. Volumes have SIZE voxels on each side, detectors twice as
many pixels. Times are the best of three.
"""

import argparse
import json
import re
import subprocess
import tempfile
import time
from pathlib import Path

import itk
import numpy as np
from itk import RTK as rtk

ROOT = Path(__file__).resolve().parents[2]
TRGS = ROOT / "target/release/trgs"
DSO, DSD, DETECTOR = 5.0, 7.0, 4.0


def trgs(threads, *arguments):
    done = subprocess.run([TRGS, *map(str, arguments), "--threads", str(threads), "--quiet", "--json"],
                          capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def best(times, f):
    """Seconds of the fastest of several calls, and the value returned by the last one."""
    seconds = []
    for _ in range(times):
        began = time.perf_counter()
        result = f()
        seconds.append(time.perf_counter() - began)
    return min(seconds), result


def psnr(truth, volume):
    return -10 * np.log10(np.mean((truth - volume) ** 2))


def image(values, spacing):
    """An image of RTK around the origin, from an array with x last."""
    made = itk.image_from_array(np.ascontiguousarray(values, dtype=np.float32))
    spacings = [spacing] * 3 if np.isscalar(spacing) else spacing
    made.SetSpacing(spacings)
    made.SetOrigin([-(n - 1) / 2 * s for n, s in zip(reversed(values.shape), spacings)])
    return made


class Rtk:
    """RTK's axes: y up, source at (sin, 0, cos) of the gantry's angle; its x, y, z are y, z, x of trgs."""

    def __init__(self, projections, angles, size):
        self.kind = itk.Image[itk.F, 3]
        self.size = size
        self.geometry = rtk.ThreeDCircularProjectionGeometry.New()
        for angle in angles:
            self.geometry.AddProjection(DSO, DSD, np.degrees(angle))
        pitch = DETECTOR / projections.shape[1]
        # Rows of trgs run downwards.
        self.projections = image(projections[:, ::-1, :], [pitch, pitch, 1.0])
        origin = [-(projections.shape[2] - 1) / 2 * pitch, -(projections.shape[1] - 1) / 2 * pitch, 0.0]
        self.projections.SetOrigin(origin)

    def empty(self):
        return image(np.zeros([self.size] * 3), 2.0 / self.size)

    def forward(self, volume):
        stack = image(np.zeros(itk.array_view_from_image(self.projections).shape), 1.0)
        stack.CopyInformation(self.projections)
        stack.SetOrigin(self.projections.GetOrigin())
        projector = rtk.JosephForwardProjectionImageFilter[self.kind, self.kind].New()
        projector.SetInput(0, stack)
        projector.SetInput(1, image(volume.transpose(0, 2, 1), 2.0 / self.size))
        projector.SetGeometry(self.geometry)
        projector.Update()
        return itk.array_from_image(projector.GetOutput())[:, ::-1, :]

    def fdk(self):
        fdk = rtk.FDKConeBeamReconstructionFilter[self.kind].New()
        fdk.SetInput(0, self.empty())
        fdk.SetInput(1, self.projections)
        fdk.SetGeometry(self.geometry)
        fdk.GetRampFilter().SetTruncationCorrection(0.0)
        fdk.Update()
        return self.ours(fdk.GetOutput())

    def sart(self, passes):
        sart = rtk.SARTConeBeamReconstructionFilter[self.kind, self.kind].New()
        sart.SetInput(0, self.empty())
        sart.SetInput(1, self.projections)
        sart.SetGeometry(self.geometry)
        sart.SetNumberOfIterations(passes)
        sart.SetLambda(1.0)
        sart.SetEnforcePositivity(True)
        sart.Update()
        return self.ours(sart.GetOutput())

    @staticmethod
    def ours(volume):
        return itk.array_from_image(volume).transpose(0, 2, 1)


def joseph(size, views, threads):
    """Seconds of trgs's Joseph projector, from its bench."""
    name = f"{size} voxels, {views} views/forward/Joseph"
    done = subprocess.run(["cargo", "bench", "--bench", "voxel_projector", "--", f"^{name}$"], cwd=ROOT, check=True,
                          capture_output=True, text=True, env={**__import__("os").environ, "RAYON_NUM_THREADS": str(threads)})
    value, unit = re.search(r"time:\s+\[\S+ \S+ (\S+) (\S+)", done.stdout).groups()
    return float(value) * {"s": 1.0, "ms": 1e-3, "µs": 1e-6}[unit]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=256, help="voxels on each side")
    parser.add_argument("--views", type=int, default=18, help="the projectors are compared at 256³ with 18 and 50, at 64³ with 18")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    size, threads = arguments.size, arguments.threads
    itk.MultiThreaderBase.SetGlobalDefaultNumberOfThreads(threads)
    itk.MultiThreaderBase.SetGlobalMaximumNumberOfThreads(threads)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        scan = folder / "scan"
        trgs(threads, "simulate", "--phantom", "shepp-logan", "--out", scan, "--size", size, "--detector", 2 * size,
             "--views", arguments.views, "--test-views", 0)
        meta = json.loads((scan / "meta_data.json").read_text())
        angles = [view["angle"] for view in meta["proj_train"]]
        projections = np.stack([np.load(scan / view["file_path"]) for view in meta["proj_train"]])
        truth = np.load(scan / "vol_gt.npy")
        peer = Rtk(projections, angles, size)

        def ours(method, *more):
            out = folder / method
            seconds = [trgs(threads, "reconstruct", scan, "--out", out, "--method", method, *more)["seconds"]
                       for _ in range(3)]
            return min(seconds), out

        their_fdk, volume = best(3, peer.fdk)
        their_psnr = psnr(truth, volume)
        our_fdk, out = ours("fdk")
        our_psnr = psnr(truth, np.load(out / "volume.npy"))
        rows.append(("FDK", our_fdk, their_fdk))

        two, _ = best(1, lambda: peer.sart(2))
        four, volume = best(1, lambda: peer.sart(4))
        _, out = ours("sart", "--iterations", 4)
        passes = [json.loads(line)["seconds"] for line in (out / "log.jsonl").read_text().splitlines()]
        rows.append(("pass of SART", (passes[3] - passes[1]) / 2, (four - two) / 2))
        sart = psnr(truth, np.load(out / "volume.npy")), psnr(truth, volume)

        if (size, arguments.views) in ((64, 18), (256, 18), (256, 50)):
            theirs, found = best(3, lambda: peer.forward(truth))
            rows.append(("Joseph, forward", joseph(size, arguments.views, threads), theirs))
            agreement = np.sqrt(np.mean((found - projections) ** 2) / np.mean(projections ** 2))
            print(f"RTK's projections of the voxels against the exact ones: {100 * agreement:.2f} % RMS")
    print(f"\n{size}³ voxels, {arguments.views} views of {2 * size}², {threads} threads\n")
    print("| | trgs, s | RTK, s | RTK / trgs |\n|---|---|---|---|")
    for name, ours_s, theirs_s in rows:
        print(f"| {name} | {ours_s:.3f} | {theirs_s:.3f} | {theirs_s / ours_s:.1f} |")
    print(f"\nPSNR of FDK: trgs {our_psnr:.2f} dB, RTK {their_psnr:.2f} dB; of four passes of SART: {sart[0]:.2f}, {sart[1]:.2f} dB")


if __name__ == "__main__":
    main()
