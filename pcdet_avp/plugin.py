"""Our classes in OpenPCDet: ``register()``, and a runner for its own scripts.

    python -m pcdet_avp.plugin                                        registers, and says what
    python -m pcdet_avp.plugin OpenPCDet/tools/train.py --cfg_file cfgs/openpcdet/cp_small.yaml
    torchrun --nproc_per_node 8 -m pcdet_avp.plugin OpenPCDet/tools/train.py --launcher pytorch --cfg_file ...

or, in a script of your own, before it builds anything: ``from pcdet_avp.plugin import register; register()``.
"""

from __future__ import annotations

import importlib
import runpy
import sys
from collections.abc import MutableMapping
from pathlib import Path

from pcdet_avp import shipped
from pcdet_avp.cli import run_tool
from pcdet_avp.errors import PluginError

OPENPCDET = "pcdet"


def our_classes() -> dict[str, dict[str, type]]:
    """Module of OpenPCDet whose ``__all__`` is the table -> name in a configuration -> class.

    ``BaseBEVBackbone`` and ``AnchorHeadSingle`` are OpenPCDet's names: ours, inside ``AvpCp``, leave them to it.
    ``FrustumToBev`` needs two cameras' calibration, which no stage of OpenPCDet hands over: it works inside ``AvpCp``.
    """
    from pcdet_avp.models.backbones_2d import wrapped_backbones
    from pcdet_avp.models.backbones_2d.map_to_bev.pillar_scatter import PillarScatter
    from pcdet_avp.models.backbones_3d.vfe.dynamic_pillars import DynamicPillars
    from pcdet_avp.openpcdet import dataset, detector, fusers

    return {
        "pcdet.datasets": {"AvpDataset": dataset.OpenPCDetAvpDataset},
        "pcdet.models.detectors": {"AvpCp": detector.OpenPCDetAvpCp},
        "pcdet.models.backbones_3d.vfe": {"DynamicPillars": DynamicPillars},
        "pcdet.models.backbones_2d.map_to_bev": {"PillarScatter": PillarScatter},
        "pcdet.models.backbones_2d.fuser": {
            "AdaFusion": fusers.TwoMapAdaFusion,
            "SpatialAdaFusion": fusers.TwoMapSpatialAdaFusion,
            "ChannelAdaFusion": fusers.TwoMapChannelAdaFusion,
            "AverageFusion": fusers.TwoMapAverageFusion,
            "MaxFusion": fusers.TwoMapMaxFusion,
        },
        "pcdet.models.backbones_2d": {
            "DeformableAttentionBackbone": wrapped_backbones.DeformableAttentionBackbone,
            "CompressedBackbone": wrapped_backbones.CompressedBackbone,
        },
    }


def registered_classes() -> dict[str, dict[str, type]]:
    """``our_classes`` as they are registered: data set and detector derive from OpenPCDet's, which is imported."""
    try:
        registered = importlib.import_module("pcdet_avp.plugin_classes")
    except ImportError as error:
        raise PluginError(f"OpenPCDet cannot be imported: {error}") from error
    kinds = {
        "pcdet.datasets": {"AvpDataset": registered.RegisteredAvpDataset},
        "pcdet.models.detectors": {"AvpCp": registered.RegisteredAvpCp},
    }
    return our_classes() | kinds


def register() -> dict[str, list[str]]:
    """Enter our classes into OpenPCDet's tables; table -> names. Again is harmless.

    Raises PluginError, and leaves every table as it was, if OpenPCDet cannot be imported or a name is taken.
    """
    tables = {module: _table(module) for module in our_classes()}
    ours = registered_classes()
    taken = [
        f"{module}.__all__[{name!r}] is {_path(tables[module][name])}"
        for module, classes in ours.items()
        for name, cls in classes.items()
        if tables[module].get(name, cls) is not cls
    ]
    if taken:
        raise PluginError(f"OpenPCDet already has classes of these names: {'; '.join(taken)}; nothing was registered")
    for module, classes in ours.items():
        tables[module].update(classes)
    return {module: sorted(classes) for module, classes in ours.items()}


def _table(module: str) -> MutableMapping:
    try:
        table = getattr(importlib.import_module(module), "__all__", None)
    except ModuleNotFoundError as error:
        if error.name == OPENPCDET:
            raise PluginError("OpenPCDet is not installed here: Python finds no package 'pcdet'") from error
        raise PluginError(f"OpenPCDet cannot be imported: {module}: {error}") from error
    except ImportError as error:
        raise PluginError(f"OpenPCDet cannot be imported: {module}: {error}") from error
    if not isinstance(table, MutableMapping):
        raise PluginError(f"{module}.__all__: expected OpenPCDet's table of classes, found {type(table).__name__}")
    return table


def _path(value: object) -> str:
    return f"{getattr(value, '__module__', '?')}.{getattr(value, '__qualname__', value)}"


def run_script(script: Path, arguments: list[str]) -> None:
    """Register, then run one of OpenPCDet's scripts as if it had been started itself."""
    if not script.is_file():
        raise PluginError(f"{script}: no such script; expected OpenPCDet's tools/train.py, tools/test.py or the like")
    folders = [script.resolve().parent]  # its neighbours (train.py imports test.py), as Python would have it
    if (folders[0].parent / OPENPCDET / "__init__.py").is_file():
        folders.append(folders[0].parent)  # a checkout that is not installed
    sys.path[:0] = [str(folder) for folder in folders]
    register()
    sys.argv = [str(script), *find_configs(arguments)]
    runpy.run_path(str(script), run_name="__main__")


def find_configs(arguments: list[str]) -> list[str]:
    """The arguments; a configuration or weights not below the working folder are those that come with the package."""
    wanted = (word for word in arguments if Path(word).suffix in shipped.PATTERNS and not Path(word).exists())
    found = {word: place for word in wanted if (place := shipped.find(word)) is not None}
    return [str(found.get(word, word)) for word in arguments]


def main() -> None:
    if len(sys.argv) > 1:
        run_script(Path(sys.argv[1]), sys.argv[2:])
        return
    for module, names in register().items():
        print(f"{module}: {', '.join(names)}")


if __name__ == "__main__":
    run_tool(main)
