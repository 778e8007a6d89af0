"""What a page consists of, found by the standard library's parser."""

from html.parser import HTMLParser

VOID = {"img", "meta", "link", "source", "br", "hr", "input"}


class HtmlFacts(HTMLParser):
    """elements: (tag, attributes, tags above it) in their order; text: of every element that has any, by tag."""

    def __init__(self, html):
        super().__init__()
        self.elements, self.text, self._open = [], [], []
        self.feed(html)
        assert self._open == [], f"not closed: {self._open}"

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs), tuple(self._open)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        if data.strip():
            self.text.append((self._open[-1] if self._open else "", " ".join(data.split())))

    def all(self, *tags):
        return [attrs for tag, attrs, _ in self.elements if tag in tags]

    def words(self, tag):
        return [text for where, text in self.text if where == tag]
