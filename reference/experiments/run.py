"""Run one experiment: every object x views x seed x variant of a TOML file, and print the means as a Markdown table.

    python run.py methods.toml --out /tmp/methods --jobs 2

A cell is one `trgs reconstruct` on a scan that `trgs simulate` made; all variants of an object, a number of views and a
seed use the same scan. Finished cells are in OUT/cells.jsonl and are not run again, so a stopped experiment continues.
Needs Python 3.11 and nothing else; `cargo build --release` first.
"""

import argparse
import json
import math
import statistics
import subprocess
import sys
import tomllib
from array import array
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock

HERE = Path(__file__).resolve().parent
METRICS = ["psnr_3d", "ssim_3d", "psnr_2d", "ssim_2d"]


def trgs(program, *arguments):
    done = subprocess.run([program, *map(str, arguments), "--quiet", "--json"], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"trgs {' '.join(map(str, arguments))}\n{done.stderr}")
    return json.loads(done.stdout)


def cells(experiment, only):
    for seed in experiment["seeds"]:
        for views in experiment["views"]:
            for thing in experiment["objects"]:
                for name, arguments in experiment["variants"].items():
                    if not only or name in only:
                        yield {"object": thing, "views": views, "seed": seed, "variant": name}, arguments


def densities(path, out):
    """A volume of bytes scaled to densities from 0 to 1; any other volume unchanged."""
    content = path.read_bytes()
    start = 10 + int.from_bytes(content[8:10], "little")
    header = content[10:start].decode()
    if "'|u1'" not in header:
        return path
    floats = out / f"{path.stem}.npy"
    text = header.replace("'|u1'", "'<f4'").rstrip()
    text += " " * (-(len(text) + 11) % 64) + "\n"
    values = array("f", (byte / 255 for byte in content[start:]))
    if sys.byteorder == "big":
        values.byteswap()
    floats.write_bytes(b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + values.tobytes())
    return floats


def scan(program, experiment, cell, out):
    """The scan of a cell, made once."""
    thing = cell["object"]
    folder = out / f"{Path(thing).stem}-{cell['views']}-{cell['seed']}"
    if not (folder / "meta_data.json").exists():
        what = ["--volume", densities((HERE / thing).resolve(), out)] if thing.endswith(".npy") else ["--phantom", thing]
        trgs(program, "simulate", *what, "--out", folder, "--views", cell["views"], "--seed", cell["seed"],
             *experiment.get("scan", []))
    return folder


def run(program, experiment, cell, arguments, out):
    data = scan(program, experiment, cell, out)
    target = out / f"{data.name}-{cell['variant']}"
    found = trgs(program, "reconstruct", data, "--out", target, "--seed", cell["seed"], "--threads", 1,
                 *experiment.get("arguments", []), *arguments)
    log = target / "log.jsonl"
    last = json.loads(log.read_text().splitlines()[-1]) if log.exists() else {}
    result = {metric: found[metric]["value"] for metric in METRICS}
    result |= {"seconds": found["seconds"], "primitives": last.get("primitives"), "spearman": last.get("spearman")}
    written = json.loads((target / "metrics.json").read_text())
    if "unfinished" in written:
        result["unfinished"] = written["unfinished"]["psnr_3d"]["value"]
    if "evidence" in written.get("sampled", {}):
        evidence = written["sampled"]["evidence"]
        ratio = math.log(evidence["point"] / evidence["interpolant"])
        result |= {"sampling": written["sampled"]["sampling"], "evidence": ratio}
    for path in sorted(target.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    target.rmdir()
    return result


def table(experiment, results):
    """Means over objects; the spread is the standard deviation over seeds of these means."""
    first = next(iter(experiment["variants"]))
    lines = ["| views | variant | PSNR_3D | SSIM_3D | PSNR_2D | SSIM_2D | PSNR_3D against " + first + " | primitives | s |",
             "|---|---|---|---|---|---|---|---|---|"]
    for views in experiment["views"]:
        for variant in experiment["variants"]:
            def column(key, of=variant):
                """seed -> mean over the objects that all seeds and variants have"""
                by_seed = {}
                for cell, result in results:
                    if (cell["views"], cell["variant"]) == (views, of) and result.get(key) is not None:
                        by_seed.setdefault(cell["seed"], {})[cell["object"]] = result[key]
                return {seed: statistics.fmean(values.values()) for seed, values in by_seed.items()
                        if len(values) == len(experiment["objects"])}

            def cell_text(values, digits):
                if not values:
                    return "-"
                spread = f" ± {statistics.stdev(values):.{digits}f}" if len(values) > 1 else ""
                return f"{statistics.fmean(values):.{digits}f}{spread}"

            metrics = [cell_text(list(column(m).values()), 2 if "psnr" in m else 4) for m in METRICS]
            ours, theirs = column("psnr_3d"), column("psnr_3d", first)
            paired = cell_text([ours[seed] - theirs[seed] for seed in ours if seed in theirs], 2)
            counts, seconds = list(column("primitives").values()), list(column("seconds").values())
            lines.append(f"| {views} | {variant} | " + " | ".join(metrics) + f" | {paired} | {cell_text(counts, 0)} | {cell_text(seconds, 0)} |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("experiment", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--program", default=str(HERE.parent.parent / "target/release/trgs"))
    parser.add_argument("--only", nargs="*", help="names of variants")
    arguments = parser.parse_args()
    experiment = tomllib.loads(arguments.experiment.read_text())
    arguments.out.mkdir(parents=True, exist_ok=True)
    log, lock = arguments.out / "cells.jsonl", Lock()
    done = {json.dumps(cell, sort_keys=True): result
            for cell, result in map(json.loads, log.read_text().splitlines())} if log.exists() else {}
    todo = [(cell, more) for cell, more in cells(experiment, arguments.only) if json.dumps(cell, sort_keys=True) not in done]
    # Scans come first, so that no two workers make the same one.
    for cell, _ in todo:
        scan(arguments.program, experiment, cell, arguments.out)

    def work(item):
        cell, more = item
        result = run(arguments.program, experiment, cell, more, arguments.out)
        with lock:
            done[json.dumps(cell, sort_keys=True)] = result
            with log.open("a") as file:
                file.write(json.dumps([cell, result]) + "\n")
            print(f"{len(done)} cells, {cell}: {result['psnr_3d']:.2f} dB, {result['seconds']:.0f} s", file=sys.stderr)

    with ThreadPoolExecutor(arguments.jobs) as workers:
        list(workers.map(work, todo))
    print(table(experiment, [(json.loads(cell), result) for cell, result in done.items()]))


if __name__ == "__main__":
    main()
