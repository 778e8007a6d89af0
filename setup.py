"""What a wheel carries beside the code: the configurations and the small weights, which lie at the top of a checkout.

They become ``pcdet_avp/_data``, where ``pcdet_avp.shipped`` looks for them. All else is in pyproject.toml.
"""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["pcdet_avp*"]), "pcdet_avp._data.cfgs", "pcdet_avp._data.weights"],
    package_dir={"pcdet_avp._data.cfgs": "cfgs", "pcdet_avp._data.weights": "weights"},
    package_data={
        "pcdet_avp": ["py.typed"],
        "pcdet_avp.closed_loop.export": ["page/episode.html", "page/episode.css", "page/episode.js"],
        "pcdet_avp.evaluation": ["paper_tables.json"],
        "pcdet_avp.sim.plans": ["plan.schema.json"],
        "pcdet_avp.visualization.page": ["page.html", "page.css"],
        "pcdet_avp._data.cfgs": ["**/*.yaml"],
        "pcdet_avp._data.weights": ["*.pth", "README.md"],
    },
    include_package_data=False,
)
