"""A page is one file that needs no other, and says the same to those who do not see it."""

import base64
import io
import re
from importlib.resources import files

import cv2
import numpy as np
import pytest
from PIL import Image, ImageSequence
from visualization.page.html_facts import HtmlFacts

from pcdet_avp.errors import ConfigError
from pcdet_avp.visualization.page import Comparison, Page, Picture, Report, Section, Table, Video, render
from pcdet_avp.visualization.page.embed import embedded_picture
from pcdet_avp.visualization.video import write_picture, write_video

GREY = np.full((40, 60, 3), 128, np.uint8)


@pytest.fixture
def picture(tmp_path):
    write_picture(tmp_path / "a.png", GREY)
    return tmp_path / "a.png"


def facts(*parts, **page):
    return HtmlFacts(render(Page("T", "sub", "sum", sections=[Section("S", "text", parts=parts)], **page)))


def test_a_picture_is_part_of_the_page_with_its_text_and_size(picture):
    (image,) = facts(Picture(picture, "a <grey> picture", "caption")).all("img")
    assert (image["alt"], image["width"], image["height"]) == ("a <grey> picture", "60", "40")
    kind, content = re.fullmatch(r"data:(image/\w+);base64,(.+)", image["src"]).groups()
    assert kind in ("image/png", "image/webp")
    shown = cv2.imdecode(np.frombuffer(base64.b64decode(content), np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(shown.astype(int) - GREY).max() <= 2


def test_a_photo_takes_fewer_bytes_than_its_png_and_looks_the_same(tmp_path):
    y, x = np.mgrid[:300, :400]
    photo = np.stack([x * 255 // 400, y * 255 // 300, (x + y) % 256], -1).astype(np.uint8)
    noise = np.random.default_rng(0).normal(0, 6, photo.shape)
    write_picture(tmp_path / "p.png", np.clip(photo + noise, 0, 255).astype(np.uint8))
    uri = embedded_picture(tmp_path / "p.png").uri
    assert uri.startswith("data:image/webp")
    assert len(uri) < (tmp_path / "p.png").stat().st_size / 2


def test_a_narrow_screen_gets_the_narrow_picture(picture, tmp_path):
    write_picture(tmp_path / "n.png", GREY[:, :20])
    (source,) = facts(Picture(picture, "a", "c", narrow=tmp_path / "n.png")).all("source")
    assert source["media"] == "(max-width: 640px)"
    assert source["width"] == "20"


def test_texts_are_no_markup(picture):
    found = facts(Picture(picture, "x", "1 < 2 & <b>bold</b>"), Table("**T** <i>", ["| <u> |", "| - |", "| a & b |"]))
    assert not found.all("b", "i", "u")
    assert "1 < 2 & <b>bold</b>" in found.words("figcaption")
    assert "a & b" in found.words("th")


def test_a_table_has_a_caption_heads_and_a_box_that_scrolls_by_keyboard():
    lines = ["| vehicle | roadside | AP |", "| - | - | - |", "| C | none | **1.5** |", "| C | CL | < 2 |"]
    found = facts(Table("**Short.** Long.", lines, "source `x`"))
    (box,) = [attrs for attrs in found.all("div") if attrs.get("class") == "scroll"]
    assert (box["role"], box["tabindex"], box["aria-label"]) == ("region", "0", "Short.")
    assert next(tag for tag, _, above in found.elements if above and above[-1] == "table") == "caption"
    heads = found.all("th")
    assert [head["scope"] for head in heads] == ["col"] * 3 + ["row"] * 4
    assert found.words("td") == ["< 2"]
    assert "1.5" in found.words("strong")


def test_what_is_no_table_is_refused():
    with pytest.raises(ConfigError, match=r"table 'C': expected one markdown table, found \['p'\]"):
        facts(Table("C", ["no table"]))


def test_a_report_comes_with_its_pictures_below_the_section(picture, tmp_path):
    text = (
        "# Top\n\n## Sizes\n\n| a |\n| - |\n| 1 |\n\n**Losses**: of blocks.\n\n| b |\n| - |\n| 2 |\n\n![plot](a.png)\n"
    )
    (tmp_path / "r.md").write_text(text + "\n### Deep\n")
    found = facts(Report("All", tmp_path / "r.md"))
    assert [tag for tag, _, _ in found.elements if re.fullmatch("h[1-6]", tag)] == ["h1", "h2", "h3", "h4"]
    assert [box["aria-label"] for box in found.all("div") if box.get("class") == "scroll"] == ["Sizes", "Losses"]
    (image,) = found.all("img")
    assert image["alt"] == "plot"
    assert image["src"].startswith("data:image/")
    assert "Top" not in found.words("h3")


@pytest.mark.parametrize("part", [Picture, Video])
def test_a_missing_file_is_named(part, tmp_path):
    with pytest.raises(ConfigError, match="gone"):
        facts(part(tmp_path / "gone.mp4", "a", "c"))


def test_a_file_that_is_no_picture_is_named(tmp_path):
    (tmp_path / "a.png").write_bytes(b"not a picture")
    with pytest.raises(ConfigError, match=r"a\.png: expected a picture, found 13 bytes"):
        facts(Picture(tmp_path / "a.png", "a", "c"))


def test_a_video_starts_with_its_poster(picture, tmp_path):
    file = write_video(tmp_path / "v.mp4", [GREY] * 10, 10.0)
    found = facts(Video(file, "grey", "c", picture, picture))
    (video,) = found.all("video")
    assert video["src"].startswith("data:video/mp4;base64,")
    assert video["poster"].startswith("data:image/")
    assert video["aria-label"] == "grey"
    assert {"controls", "playsinline"} <= set(video)
    assert "autoplay" not in video
    assert len(found.all("details")) == 1


def test_a_video_that_browsers_do_not_play_becomes_an_animated_picture(tmp_path):
    file = tmp_path / "v.mp4"
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*"mp4v"), 10.0, (60, 40))
    for shade in (0, 120, 240):
        writer.write(np.full((40, 60, 3), shade, np.uint8))
    writer.release()
    found = facts(Video(file, "three shades", "c"))
    assert not found.all("video")
    (image,) = found.all("img")
    content = base64.b64decode(image["src"].removeprefix("data:image/webp;base64,"))
    frames = pictures_of(content)
    assert [frame.mean() for frame in frames] == pytest.approx([0, 120, 240], abs=6)


def pictures_of(webp):
    return [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(Image.open(io.BytesIO(webp)))]


def test_numbers_without_and_with_the_roadside_stand_side_by_side():
    found = facts(comparisons=[Comparison("AP of cars", "26.3", "82.1", "IoU 0.7")])
    assert found.words("span")[:1] == ["26.3"]
    assert "82.1" in found.words("span")
    assert {"AP of cars", "IoU 0.7"} <= {text for _, text in found.text}


def luminance(colour):
    channels = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return sum(weight * c for weight, c in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_texts_have_the_contrast_that_wcag_asks_for(scheme):
    css = files("pcdet_avp.visualization.page").joinpath("page.css").read_text()
    blocks = re.findall(r":root \{(.*?)\}", css, re.DOTALL)
    colours = dict(re.findall(r"--(\w+): (#\w{6})", blocks[scheme]))
    for text in ("text", "quiet", "accent", "good"):
        for ground in ("ground", "raised", "code"):
            light, dark = sorted((luminance(colours[text]), luminance(colours[ground])), reverse=True)
            assert (light + 0.05) / (dark + 0.05) >= 4.5, (text, ground)
