import pytest
from tour.made_up_results import STEPS, make_tour

from pcdet_avp.tour.page import tour_page
from pcdet_avp.tour.steps import Tour
from pcdet_avp.visualization.page import render


@pytest.fixture(scope="session")
def finished_tour(tmp_path_factory, tiny_data):
    """A tour with made-up results, and its page as HTML; read only."""
    folder = tmp_path_factory.mktemp("tour")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        tour = Tour(make_tour(folder, tiny_data), train_minutes=3, episodes=3)
        html = render(tour_page(tour, STEPS))
    (folder / "index.html").write_text(html, encoding="utf-8")
    return tour, html


@pytest.fixture
def made_up(finished_tour, monkeypatch):
    """The same, in the working folder that the tour was run in."""
    monkeypatch.chdir(finished_tour[0].place.out)
    return finished_tour
