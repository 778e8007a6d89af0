"""Installs pcdet_avp. torch is pinned in constraints.txt; on a machine without a GPU install its CPU build first."""

import re
from pathlib import Path

from setuptools import find_packages, setup

HERE = Path(__file__).parent
VERSION = re.search(r'__version__ = "(.+)"', (HERE / "pcdet_avp" / "__init__.py").read_text()).group(1)

setup(
    name="pcdet_avp",
    version=VERSION,
    description="Infrastructure-assisted collaborative perception for automated valet parking, as an OpenPCDet plugin",
    long_description=(HERE / "README.md").read_text(),
    long_description_content_type="text/markdown",
    packages=find_packages(include=["pcdet_avp*"]),
    package_data={"pcdet_avp.evaluation": ["paper_tables.json"]},
    python_requires=">=3.10",
    install_requires=[
        "torch>=2.6",
        "numpy>=1.26",
        "numba>=0.59",
        "opencv-python-headless>=4.8",
        "easydict>=1.11",
        "tensorboard>=2.14",
        "PyYAML>=6.0",
        "tqdm>=4.65",
        "scipy>=1.11",
        "embreex>=4.4.0",
        "distributed>=2024.1",
        "matplotlib>=3.8",
        "zstandard>=0.22",
    ],
    extras_require={
        "gym": ["gymnasium>=0.29"],
        "cpm": ["asn1tools>=0.169"],
        "test": ["pytest>=8.0", "hypothesis>=6.90", "shapely>=2.0", "ruff>=0.5", "asn1tools>=0.169"],
    },
)
