"""Input for the parsers led by the code it reaches, by atheris: what reaches new code is kept and changed further.

`python -m benchmarks.guided_fuzz PARSER [--runs N] [--seconds S]`; without a parser all have their turn. A case ends as
in `benchmarks.fuzz`. atheris has wheels for Linux on x86-64: `pip install atheris`.
"""

import argparse
import faulthandler
import multiprocessing
import os
import sys
import tempfile
from importlib.util import find_spec
from multiprocessing.sharedctypes import SynchronizedArray
from pathlib import Path

KINDS = ("value", "error", "wrong")
"""What is counted: the ends of `benchmarks.fuzz.outcome`, all that should not be taken together."""


def with_kernels() -> list[str]:
    """Modules that atheris leaves alone: Numba could not compile what it has changed."""
    root = Path(__file__).parents[1] / "src"
    files = [path.relative_to(root) for path in root.rglob("*.py") if "compiled" in path.read_text("utf-8")]
    return [".".join(path.with_suffix("").parts) for path in files]


def guide(name: str, bounds: list[str], there: Path, keep: Path, counts: "SynchronizedArray[int]") -> None:
    """Fuzz one parser; libFuzzer ends the process."""
    import atheris

    corpus, words, log = there / "corpus", there / "words", (keep / f"{name}.log").open("w")
    os.dup2(log.fileno(), sys.stderr.fileno())  # libFuzzer writes there too
    corpus.mkdir()
    with atheris.instrument_imports(["heliograph", "tomllib", "json", "zipfile"], with_kernels()):
        from benchmarks.fuzz import LIMIT_BYTES, LIMIT_S, WORDS, limited, outcome, seeds

        parser, good = seeds(there)[name]
    for k, data in enumerate(good):
        assert outcome(parser, data, there) == "value", name
        (corpus / str(k)).write_bytes(data)
    # libFuzzer takes words of up to 64 bytes
    words.write_text("".join('"\\x' + word.hex(":").replace(":", "\\x") + '"\n' for word in WORDS if len(word) <= 64))
    seen = set[str]()

    def run(data: bytes) -> None:
        (keep / f"{name}-last").write_bytes(data)
        faulthandler.dump_traceback_later(3 * LIMIT_S, exit=True)  # a library written in C hears no signal
        found = outcome(parser, data, there)
        counts[KINDS.index(found if found in KINDS else "wrong")] += 1
        if found not in KINDS and found not in seen:
            seen.add(found)
            (keep / f"{name}-{len(seen)}").write_bytes(data)
            print(f"    {found}", flush=True)

    # the alarm stays that of `limited`: atheris takes none that has a handler
    fixed = [f"-rss_limit_mb={LIMIT_BYTES >> 20}", f"-max_len={2 * max(map(len, good))}", "-seed=1", "-verbosity=0"]
    files = [f"-dict={words}", f"-artifact_prefix={keep / name}-", str(corpus)]
    with limited():
        atheris.Setup([sys.argv[0], *fixed, *bounds, *files], run)
        atheris.Fuzz()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parser", nargs="*", help="as `benchmarks.fuzz` names them; all where none is named")
    parser.add_argument("--runs", type=int, default=2000, help="of each parser; -1: until its time is over")
    parser.add_argument("--seconds", type=int, default=0, help="of each parser; 0: until its runs are done")
    parser.add_argument("--keep", type=Path, help="folder for the inputs that end in something else")
    chosen = parser.parse_args()
    if find_spec("atheris") is None:
        sys.exit("atheris is not installed: pip install atheris")
    from benchmarks.fuzz import seeds

    with tempfile.TemporaryDirectory() as folder:
        names = list(seeds(Path(folder)))
    if not set(chosen.parser) <= set(names):
        parser.error(f"the parsers are {', '.join(names)}")
    spawn, wrong = multiprocessing.get_context("spawn"), 0
    row = "{:10} {:>8} {:>8} {:>8} {:>6} {:>8}".format
    print(row("parser", "runs", "values", "errors", "wrong", "corpus"))
    for name in chosen.parser or names:
        with tempfile.TemporaryDirectory() as folder:
            there, keep = Path(folder), chosen.keep or Path(folder)
            keep.mkdir(parents=True, exist_ok=True)
            counts = spawn.Array("q", len(KINDS))
            bounds = [f"-runs={chosen.runs}", f"-max_total_time={chosen.seconds}"]
            process = spawn.Process(target=guide, args=(name, bounds, there, keep, counts))
            process.start()
            process.join()
            wrong += counts[2] + (process.exitcode != 0)
            print(row(name, sum(counts[:]), *counts[:], len(list((there / "corpus").glob("*")))), flush=True)
            if process.exitcode:
                print(f"    ended with {process.exitcode}:", (keep / f"{name}.log").read_text()[-1000:])
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
