"""The page in headless Chromium: pictures load, videos play, nothing is requested, nothing overflows."""

import pytest
from chromium import running_chromium

SCREENS = {"phone": (390, 844), "desktop": (1280, 900)}

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser():
    with running_chromium() as running:
        yield running


@pytest.fixture(scope="module", params=[(s, c) for s in SCREENS for c in ("light", "dark")], ids="-".join)
def opened(request, browser, finished_tour):
    """The page on a screen in a colour scheme, what it requested and what its console said."""
    name, scheme = request.param
    width, height = SCREENS[name]
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
    page, requests, messages = context.new_page(), [], []
    page.set_default_timeout(120_000)
    page.on("request", lambda asked: requests.append(asked.url))
    page.on("console", lambda said: messages.append(said.text))
    page.on("pageerror", lambda error: messages.append(str(error)))
    page.goto((finished_tour[0].place.out / "index.html").as_uri())
    page.evaluate("document.querySelectorAll('details').forEach(part => part.open = true)")
    page.evaluate("Promise.all([...document.images].map(image => { image.loading = 'eager'; return image.decode() }))")
    yield page, requests, messages
    context.close()


def test_every_picture_loads(opened):
    sizes = opened[0].evaluate("[...document.images].map(image => [image.naturalWidth, image.clientWidth])")
    assert len(sizes) >= 10
    assert all(natural > 0 and shown > 0 for natural, shown in sizes)


def test_every_video_plays_and_had_a_poster(opened):
    play = """async () => {
        const times = []
        for (const video of document.querySelectorAll('video')) {
            await video.play()
            await new Promise(done => video.addEventListener('timeupdate', () => video.currentTime > 0.3 && done()))
            times.push([video.currentTime, video.videoWidth, video.poster.slice(0, 11)])
        }
        return times
    }"""
    videos = opened[0].evaluate(play)
    assert len(videos) == 2
    for time_s, width, poster in videos:
        assert time_s > 0.3
        assert width == 320
        assert poster == "data:image/"


def test_no_request_leaves_the_page(opened):
    _, requests, _ = opened
    assert [url for url in requests if not url.startswith("data:")] == requests[:1]
    assert requests[0].startswith("file:")


def test_the_console_is_silent(opened):
    assert opened[2] == []


def test_nothing_overflows_sideways_and_wide_tables_scroll_by_themselves(opened):
    page = opened[0]
    wide, window = page.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
    assert wide <= window
    scrolling = page.evaluate(
        "[...document.querySelectorAll('.scroll')].map(box => [box.scrollWidth > box.clientWidth, box.clientWidth])"
    )
    assert all(width <= window for _, width in scrolling)
    if window == SCREENS["phone"][0]:
        assert any(scrolls for scrolls, _ in scrolling)


def test_captions_fit_the_screen(opened):
    page = opened[0]
    edges = page.evaluate("[...document.querySelectorAll('caption p')].map(p => p.getBoundingClientRect().right)")
    assert max(edges) <= page.evaluate("window.innerWidth")


def test_dark_screens_get_a_dark_page(browser, finished_tour):
    grounds = []
    for scheme in ("light", "dark"):
        page = browser.new_page(color_scheme=scheme)
        page.goto((finished_tour[0].place.out / "index.html").as_uri())
        colour = page.evaluate("getComputedStyle(document.body).backgroundColor")
        grounds.append(sum(int(part) for part in colour.removeprefix("rgb(").removesuffix(")").split(",")) / 3)
        page.close()
    assert grounds[0] > 230
    assert grounds[1] < 40
