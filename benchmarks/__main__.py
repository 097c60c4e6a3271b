"""Run all benchmarks: medians, and ratios to something measured in the same run."""

import sys
from importlib import import_module
from pathlib import Path


def main() -> None:
    names = sorted(p.stem for p in Path(__file__).parent.glob("*.py") if not p.stem.startswith("_"))
    sys.argv = sys.argv[:1]
    failed = []
    for name in names:
        print(f"\n== {name}", flush=True)
        try:
            import_module(f"benchmarks.{name}").main()
        except SystemExit as end:  # the fuzzers end with a status
            if end.code:
                failed.append(f"{name}: {end.code}")
    if failed:
        sys.exit("\n".join(failed))


if __name__ == "__main__":
    main()
