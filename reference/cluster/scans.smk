"""Many scans, methods and settings under any of Snakemake's executors: a CSV in, a table and a page out.

    pip install -r requirements.txt
    snakemake -s scans.smk --cores 2 --config list=scans.csv out=out/many
    snakemake -s scans.smk --executor slurm --jobs 100 --config list=scans.csv out=/shared/many

`list` has a line for each run, with the columns `scan` (a folder or file that `trgs reconstruct` reads), and optionally `name`,
`method` and `settings` (as for --set, separated by spaces). `trgs` is the program (default: target/release/trgs of this project).

A run is one job on one core, in OUT/runs/NAME. One that was killed goes on from its checkpoint when it is tried again, once unless
`retries` says otherwise. One that is refused, or killed each time, is a row of the table with its message. OUT/table.csv and
OUT/table.html have all runs. Finished runs are not run again; to try a failed one again, delete OUT/runs/NAME.json.
"""
import csv
import html
import json
import os
import shlex
import subprocess
from pathlib import Path
from urllib.parse import quote

from snakemake.exceptions import WorkflowError

TRGS = config.get("trgs", str(Path(workflow.basedir).parents[1] / "target/release/trgs"))
OUT = config["out"]
RETRIES = int(config.get("retries", 1))
REFUSED = 2
METRICS = ["psnr_3d", "ssim_3d", "psnr_2d", "ssim_2d", "residual"]


def listed():
    with open(config["list"], newline="") as file:
        lines = list(csv.DictReader(file))
    columns = {"scan", "name", "method", "settings"}
    if unknown := {column for line in lines for column in line if column not in columns}:
        raise SystemExit(f"{config['list']}: columns {sorted(map(str, unknown))}, expected {sorted(columns)}")
    runs = {}
    for line in lines:
        scan, method = line["scan"], line.get("method") or "tr-gs"
        name = line.get("name") or "-".join([Path(scan).stem, method, *shlex.split(line.get("settings") or "")]).replace("/", "-")
        if name in runs or name in (".", "..") or "/" in name:
            raise SystemExit(f"{config['list']}: name {name!r}, expected one without / and of one line; give the lines a name")
        runs[name] = {"scan": scan, "method": method, "settings": line.get("settings") or ""}
    return runs


RUNS = listed()


def status(name):
    return json.loads(Path(f"{OUT}/runs/{name}.json").read_text())


localrules: table

rule table:
    default_target: True
    input: [f"{OUT}/runs/{name}.json" for name in RUNS]
    output: f"{OUT}/table.csv", f"{OUT}/table.html"
    run:
        rows = []
        for name, of in RUNS.items():
            found = status(name)
            metrics = [found["metrics"].get(metric, "") for metric in METRICS]
            rows.append([name, *of.values(), found["error"] or "finished", *metrics])
        head = ["name", "scan", "method", "settings", "status", *METRICS]
        with open(output[0], "w", newline="") as file:
            csv.writer(file).writerows([head, *rows])
        def cells(row):
            failed = row[4] != "finished"
            link = html.escape(row[0])
            if not failed:
                link = f'<a href="runs/{quote(row[0])}/report.html">{link}</a>'
            numbers = [f"{value:.4g}" if isinstance(value, float) else value for value in row[5:]]
            texts = [link, *(html.escape(str(value)) for value in [*row[1:5], *numbers])]
            return f'<tr{" class=failed" if failed else ""}>' + "".join(f"<td>{text}</td>" for text in texts) + "</tr>"
        style = "body{font:15px system-ui;margin:2rem}td,th{padding:.2rem .6rem;text-align:left}.failed{background:#fbe3d6}"
        Path(output[1]).write_text(
            f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Runs</title><style>{style}</style><table><tr>'
            + "".join(f"<th>{name}</th>" for name in head) + "</tr>\n" + "\n".join(map(cells, rows)) + "</table></html>\n")

rule one:
    output: OUT + "/runs/{name}.json"
    threads: 1
    retries: RETRIES
    resources: attempt=lambda wildcards, attempt: attempt
    run:
        of = RUNS[wildcards.name]
        folder = Path(OUT) / "runs" / wildcards.name
        command = [TRGS, "reconstruct", of["scan"], "--out", str(folder), "--method", of["method"], "--threads", "1", "--quiet"]
        command += [part for setting in shlex.split(of["settings"]) for part in ("--set", setting)]
        if (folder / "checkpoints").is_dir():
            command.append("--resume")
        done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "NO_COLOR": "1"})
        error = ""
        if done.returncode:
            error = (done.stderr.strip().splitlines() or [f"ended with {done.returncode}"])[-1]
            if done.returncode != REFUSED and resources.attempt <= RETRIES:
                raise WorkflowError(f"{wildcards.name}: {error}")
        path = folder / "metrics.json"
        found = json.loads(path.read_text()) if not error and path.exists() else {}
        metrics = {name: found[name].get("value", found[name].get("relative")) for name in METRICS if name in found}
        Path(output[0]).write_text(json.dumps({"error": error, "metrics": metrics}))
