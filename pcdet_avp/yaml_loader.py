"""Safe YAML whose values all have an end: the loader of configurations and of garage plans."""

from __future__ import annotations

import yaml


class FiniteLoader(yaml.SafeLoader):
    """YAML's safe loader; an alias of a value that it lies in is a ComposerError at the alias's place.

    PyYAML makes a value that contains itself of it, and whoever walks through that never comes to an end. An alias of
    what is complete stands for its value, as elsewhere.
    """

    def __init__(self, stream) -> None:
        super().__init__(stream)
        self._inside: list[str | None] = []  # anchors of the values that the one being read lies in

    def compose_node(self, parent, index):
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent) and event.anchor in self._inside:
            problem = f"alias *{event.anchor} of what it lies in has no end"
            raise yaml.composer.ComposerError(None, None, problem, event.start_mark)
        self._inside.append(event.anchor)
        node = super().compose_node(parent, index)
        self._inside.pop()
        return node
