import ast
from collections import defaultdict
from pathlib import Path

import heliograph.receive

ROOM = Path(heliograph.receive.__file__).parent

OWN = ("LOG",)
"""Names that each module gives to its own: they are no constants."""


def assigned(module: Path) -> set[str]:
    """Upper-case names that a module assigns, those that it imports left out."""
    names = set()
    for node in ast.parse(module.read_text()).body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        names |= {one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)}
    return {name for name in names if name.isupper() and name not in OWN}


def test_a_constant_of_the_receivers_has_its_name_alone() -> None:
    modules = defaultdict(list)
    for module in sorted(ROOM.rglob("*.py")):
        for name in assigned(module):
            modules[name].append(str(module.relative_to(ROOM)))
    assert len(modules) > 150
    assert {name: where for name, where in modules.items() if len(where) > 1} == {}
