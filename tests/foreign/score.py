"""Counts the right verdicts on data sets whose label stands beside them, as the scripts here write them.

    score.py RB_HOST FOLDER [NAME...]      # diagnoses FOLDER/NAME, or all, and prints a table and the count

Right is: no effect and `none` without a cause; `unknown` for a cause outside the library; else as many effects as causes, every cause among them
or in their classes, and not `unknown`. A cause `a|b` may be told as either.
"""

import json
import subprocess
import sys
from pathlib import Path


def classes(verdict):
    """What is named: one set of effects, alike to this data, for every effect."""
    alike = [set(a["effects"]) for a in verdict["ambiguous"]]
    return [next((a for a in alike if e["effect"] in a), {e["effect"]}) for e in verdict["effects"]]


def right(truth, verdict):
    """Whether the verdict says what was planted."""
    said, word = classes(verdict), verdict["verdict"]
    if truth == ["unknown"]:
        return word == "unknown"
    if not truth:
        return word == "none" and not said
    told = all(any(set(cause.split("|")) & c for c in said) for cause in truth)
    return told and len(said) == len(truth) and word != "unknown"


def main():
    """Diagnoses and counts."""
    host, root, wanted = sys.argv[1], Path(sys.argv[2]), sys.argv[3:]
    names = wanted or sorted(p.name.removesuffix(".label.json") for p in root.glob("*.label.json"))
    count = 0
    print("| data set | planted | said | right |\n|---|---|---|---|")
    for name in names:
        truth = json.loads((root / f"{name}.label.json").read_text())["truth"]
        done = subprocess.run([host, "--json", "gap", "report", str(root / name)], capture_output=True, text=True, check=True)
        verdict = json.loads(done.stdout)
        good = right(truth, verdict)
        count += good
        said = [" or ".join(sorted(c)) for c in classes(verdict)]
        print(f"| {name} | {', '.join(truth) or '-'} | {verdict['verdict']}: {', '.join(said) or '-'} | {'yes' if good else 'NO'} |", flush=True)
    print(f"\n{count} of {len(names)}")


if __name__ == "__main__":
    main()
