"""Safe YAML whose values all have an end: the loader of configurations and of garage plans."""

from __future__ import annotations

import yaml

MOST_VALUES = 100_000  # that a file with aliases may stand for


class FiniteLoader(yaml.SafeLoader):
    """YAML's safe loader; an alias of a value that it lies in is a ComposerError at the alias's place.

    PyYAML makes a value that contains itself of it, and whoever walks through that never comes to an end. An alias of
    what is complete stands for its value, as elsewhere; so a few lines, each of which names the one before ten times,
    stand for more values than anybody can walk through: beyond ``MOST_VALUES`` that is a ComposerError, too.
    """

    def __init__(self, stream) -> None:
        super().__init__(stream)
        self._inside: list[str | None] = []  # anchors of the values that the one being read lies in
        self._values = 0  # so far, those behind aliases counted each time
        self._values_of: dict[str | None, int] = {}  # by anchor

    def compose_node(self, parent, index):
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent) and event.anchor in self._inside:
            problem = f"alias *{event.anchor} of what it lies in has no end"
            raise yaml.composer.ComposerError(None, None, problem, event.start_mark)
        if isinstance(event, yaml.AliasEvent):
            self._values += self._values_of.get(event.anchor, 0)
            if self._values > MOST_VALUES:
                problem = f"alias *{event.anchor}: the file stands for more than {MOST_VALUES} values with it"
                raise yaml.composer.ComposerError(None, None, problem, event.start_mark)
            return super().compose_node(parent, index)
        before = self._values
        self._values += 1
        self._inside.append(event.anchor)
        node = super().compose_node(parent, index)
        self._inside.pop()
        self._values_of[event.anchor] = self._values - before
        return node
