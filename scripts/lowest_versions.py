"""Print pip constraints that hold each direct dependency to the lowest version that pyproject.toml allows.

    python scripts/lowest_versions.py > constraints.txt

Development tools are left free. Run it with the lowest Python allowed: newer ones lack wheels of some of the versions.
"""

import re
import sys
import tomllib
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).parents[1] / "pyproject.toml"
FLOOR = re.compile(r"(?P<name>[\w.-]+)(\[[\w,.-]+\])?>=(?P<version>[\d.]+)( *;.*)?")


def lowest_versions(project: dict[str, Any]) -> list[str]:
    """Return a constraint "name==version" for each dependency, those of the extras included.

    Parameters
    ----------
    project
        The table `project` of pyproject.toml. Its extras `dev` and `docs` serve the development alone and are left
        out.

    Raises
    ------
    ValueError
        A requirement is not of the form "name>=version" or "name[extra]>=version", with a marker or without.
    """
    extras = project["optional-dependencies"]
    lists = [project["dependencies"], *(extras[name] for name in extras if name not in ("dev", "docs"))]
    return [_constraint(requirement) for requirements in lists for requirement in requirements]


def _constraint(requirement: str) -> str:
    found = FLOOR.fullmatch(requirement)
    if found is None:
        raise ValueError(f"pyproject.toml: '{requirement}' is not of the form name>=version")
    return f"{found['name']}=={found['version']}"


def main() -> None:
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    lowest = project["requires-python"].removeprefix(">=")
    running = f"{sys.version_info.major}.{sys.version_info.minor}"
    if running != lowest:
        sys.exit(f"this is Python {running}, the lowest versions need {lowest}: make test-lowest PYTHON=python{lowest}")
    print("\n".join(lowest_versions(project)))


if __name__ == "__main__":
    main()
