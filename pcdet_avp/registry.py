"""The tables in which a configuration's NAME finds its class. They hold classes only; nothing here imports torch.

A class enters its table where it is defined, under a name that grep finds:

    @VFE.register("DynamicPillars")
    class DynamicPillars(nn.Module): ...

and is looked up by the name of the YAML file: ``VFE[model_cfg.VFE.NAME]``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TypeVar

from pcdet_avp.errors import RegistryError

Class = TypeVar("Class", bound=type)


class Registry(Mapping):
    """A mapping name -> class that refuses unknown and duplicate names and then lists the known ones."""

    def __init__(self, key: str) -> None:
        """``key`` is the configuration key whose value is looked up here, for error messages."""
        self.key = key
        self._classes: dict[str, type] = {}

    def register(self, name: str) -> Callable[[Class], Class]:
        """Class decorator: enter the class under ``name``."""

        def enter(cls: Class) -> Class:
            if name in self._classes:
                raise RegistryError(
                    f"{self.key}: {name!r} is already registered as {_path(self._classes[name])}, "
                    f"so {_path(cls)} cannot take the name; known: {self._known()}"
                )
            self._classes[name] = cls
            return cls

        return enter

    def __getitem__(self, name: str) -> type:
        if name not in self:
            raise RegistryError(f"{self.key}: unknown name {name!r}; known: {self._known()}")
        return self._classes[name]

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name in self._classes

    def __iter__(self) -> Iterator[str]:
        return iter(self._classes)

    def __len__(self) -> int:
        return len(self._classes)

    def __repr__(self) -> str:
        return f"Registry({self.key}: {self._known()})"

    def _known(self) -> str:
        return ", ".join(sorted(self._classes)) or "none (is the package that defines them imported?)"


def _path(cls: type) -> str:
    return f"{cls.__module__}.{cls.__qualname__}"


DATASETS = Registry("DATA_CONFIG.DATASET")
DETECTORS = Registry("MODEL.NAME")
VFE = Registry("MODEL.VFE.NAME")
MAP_TO_BEV = Registry("MODEL.MAP_TO_BEV.NAME")
BACKBONES_2D = Registry("MODEL.BACKBONE_2D.NAME")
DENSE_HEADS = Registry("MODEL.DENSE_HEAD.NAME")
COMPRESSION = Registry("MODEL.COMPRESSION.NAME")
FUSERS = Registry("MODEL.FUSER.NAME")
