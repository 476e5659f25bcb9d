"""How a hunt with generated questions finds the deliberate bugs:  python3 hunts.py TRGS numpy|torch [f64|f32] [FIRST [LAST]] > RESULT.md

The bugs are those of bugs.py here and beside the PyTorch backend. Each is hunted in its first stage with 200 questions of level `core`, and
with 200 of level `stress` if that finds nothing. No fixed question is asked.
"""
import importlib.util, json, resource, statistics, subprocess, sys, tempfile
from collections import Counter
from pathlib import Path

import bugs as shared

HERE = Path(__file__).parent
LEVELS = {"core": 200, "stress": 200}
WORDS = {"f64": "float64", "f32": "float32"}


def backend_and_bugs(name):
    if name == "numpy":
        return HERE / "backend.py", shared.BUGS
    spec = importlib.util.spec_from_file_location("torch_bugs", HERE.parent / "example_backend_torch/bugs.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return HERE.parent / "example_backend_torch/backend.py", module.BUGS


def processor_time():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def hunt(trgs, precision, bug, text, folder, levels=LEVELS):
    command = [sys.executable, "-W", "ignore", str(shared.mutated(bug, text, folder))]
    # The hunt appends the two folders; the precision comes after them.
    (folder / "run.sh").write_text('exec "$@" ' + WORDS[precision])
    begin = processor_time()
    for level, cases in levels.items():
        out = folder / level
        asked = ["--stage", bug[1].split(",")[0], "--cases", str(cases), "--precision", precision, "--level", level, "--out", str(out)]
        done = subprocess.run([trgs, "oracle", "hunt", *asked, "--", "sh", str(folder / "run.sh"), *command], capture_output=True, text=True)
        assert done.returncode in (0, 1), f"{bug[0]}: {done.stderr}"
        findings = json.loads((out / "hunt.json").read_text())["findings"]
        if findings:
            return level, findings, processor_time() - begin
    return None, [], processor_time() - begin


def main(trgs, name, precision="f64", first="0", last="999"):
    backend, bugs = backend_and_bugs(name)
    text, bugs = backend.read_text(), bugs[int(first):int(last)]
    print("| bug | stage | found at | processor seconds | primitives × elements | name |", "|---|---|---|---|---|---|", sep="\n")
    found, times, small, names = Counter(), [], Counter(), Counter()
    for bug in bugs:
        with tempfile.TemporaryDirectory() as scratch:
            level, findings, seconds = hunt(trgs, precision, bug, text, Path(scratch) / "bug")
        found[level] += 1
        times.append(seconds)
        sizes = [(f["primitives"], f["elements"]) for f in findings]
        small.update(m <= 3 and n <= 4 for m, n in sizes)
        told = [shared.verdict(f["looks_like"], bug[2]) for f in findings]
        names.update((("catalogue" if bug[2] else "other"), word) for word in told)
        print(f"| {bug[0]} | {bug[1].split(',')[0]} | {level} | {seconds:.1f} | {', '.join(f'{m} × {n}' for m, n in sizes)}"
              f" | {', '.join(told)} |", flush=True)
    print(f"\n{len(bugs)} bugs: {dict(found)}; median {statistics.median(times):.1f} s of one core; small: {dict(small)}; names: {dict(names)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
