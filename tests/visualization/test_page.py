"""A page shows what exists, relative to where it lies, and takes no text for markup."""

from html.parser import HTMLParser

from pcdet_avp.visualization.page import Section, page


class Sources(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.found, self.text = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found += [(tag, value) for key, value in attrs if key in ("src", "href")]

    def handle_data(self, data):
        self.text.append(data)


def test_pictures_videos_and_links_are_relative_and_missing_files_are_left_out(tmp_path):
    for name in ("a.png", "b.mp4", "c.json"):
        (tmp_path / name).write_bytes(b"")
    figures = [tmp_path / name for name in ("a.png", "b.mp4", "gone.png")]
    section = Section("t", "s", figures=figures, links=[tmp_path / "c.json", tmp_path / "gone.json"])
    found = Sources(page("p", [section], tmp_path / "deep")).found
    assert found == [("a", "../a.png"), ("img", "../a.png"), ("video", "../b.mp4"), ("a", "../c.json")]


def test_tables_are_shown_as_they_are(tmp_path):
    (tmp_path / "table.md").write_text("| <b> | a & b |\n")
    text = Sources(page("p", [Section("1 < 2", "s", "run --x '<y>'", [tmp_path / "table.md"])], tmp_path)).text
    assert {"1 < 2", "run --x '<y>'", "| <b> | a & b |"} <= set(text)
