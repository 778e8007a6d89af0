"""Who imports whom in pcdet_avp, read from the source: lazy imports and those for type checkers count, too."""

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pcdet_avp

PACKAGE = Path(pcdet_avp.__file__).parent


def modules() -> dict[str, Path]:
    """name -> file of every module of the package."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = ("pcdet_avp", *path.relative_to(PACKAGE).with_suffix("").parts)
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def _named(node: ast.AST, known: dict[str, Path]) -> Iterator[str]:
    """The modules of ours that an import statement names."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module:
        for alias in node.names:
            inner = f"{node.module}.{alias.name}"
            yield inner if inner in known else node.module


def module_graph() -> dict[str, set[str]]:
    """module -> the modules that it imports anywhere in its source."""
    known = modules()
    graph = {}
    for name, path in known.items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        graph[name] = {m for node in ast.walk(tree) for m in _named(node, known) if m in known and m != name}
    return graph


def room_graph(package: str) -> dict[str, set[str]]:
    """Rooms directly below a package (sub-packages and modules) -> the rooms of the same package that they import."""
    prefix, graph = package + ".", {}
    for name, imported in module_graph().items():
        if name.startswith(prefix):
            room = name[len(prefix) :].split(".")[0]
            others = {m[len(prefix) :].split(".")[0] for m in imported if m.startswith(prefix)}
            graph.setdefault(room, set()).update(others - {room})
    return graph


def circle(graph: dict[str, set[str]]) -> list[str] | None:
    """Nodes of one circle, the first again at the end; None if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return None


def floors(graph: dict[str, set[str]]) -> dict[str, int]:
    """Node -> length of the longest chain of imports below it; the graph has no circle."""
    height: dict[str, int] = {}
    for node in TopologicalSorter(graph).static_order():
        height[node] = 1 + max((height[below] for below in graph.get(node, ())), default=-1)
    return height


def summary(graph: dict[str, set[str]]) -> str:
    """``12 rooms, 26 arrows, 7 floors`` or the circle."""
    arrows, found = sum(map(len, graph.values())), circle(graph)
    shape = f"circle {' -> '.join(found)}" if found else f"{max(floors(graph).values()) + 1} floors"
    return f"{len(graph)} rooms, {arrows} arrows, {shape}"


if __name__ == "__main__":
    for package in ("pcdet_avp", *(f"pcdet_avp.{p.name}" for p in PACKAGE.iterdir() if (p / "__init__.py").exists())):
        print(f"{package}: {summary(room_graph(package))}")
    print(f"modules: {summary(module_graph())}")
