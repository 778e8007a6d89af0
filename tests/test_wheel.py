"""What a wheel carries, and that an installed package works in an empty folder with nothing of the checkout."""

import json
import os
import runpy
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
SMALL = ("--cfg", "cfgs/avp/cp_small.yaml")
VIDEO = """
import gymnasium
from gymnasium.wrappers import RecordVideo
env = gymnasium.make("pcdet_avp.closed_loop.gym_env:pcdet_avp/TJunction-v0", cruising_mps=8.0, render_mode="rgb_array")
env = RecordVideo(env, "videos", video_length=10)
env.reset(seed=0)
for _ in range(12):
    env.step(env.action_space.high)
env.close()
"""


def carried(monkeypatch):
    """Path in the wheel -> file of the checkout, by what setup.py says."""
    setuptools, said = pytest.importorskip("setuptools"), {}
    monkeypatch.chdir(REPOSITORY)
    monkeypatch.setattr(setuptools, "setup", lambda **arguments: said.update(arguments))
    runpy.run_path("setup.py")
    files = {}
    for package in said["packages"]:
        folder = Path(said["package_dir"].get(package, package.replace(".", "/")))
        for pattern in ("*.py", *said["package_data"].get(package, ())):
            for file in folder.glob(pattern):
                files[f"{package.replace('.', '/')}/{file.relative_to(folder).as_posix()}"] = file
    return files


def test_a_wheel_carries_all_code_configurations_weights_and_tables(monkeypatch):
    files = set(carried(monkeypatch))
    code = {file.relative_to(REPOSITORY).as_posix() for file in REPOSITORY.glob("pcdet_avp/**/*.py")}
    configurations = {file.relative_to(REPOSITORY).as_posix() for file in REPOSITORY.glob("cfgs/**/*.yaml")}
    assert files >= code
    assert files >= {f"pcdet_avp/_data/{name}" for name in configurations}
    assert "pcdet_avp/_data/cfgs/avp/cp_small.yaml" in files
    assert files >= {"pcdet_avp/py.typed", "pcdet_avp/evaluation/paper_tables.json"}
    assert files >= {f"pcdet_avp/_data/weights/{name}.pth" for name in ("cp_small", "cp_small_first")}
    assert not [name for name in files if not name.startswith("pcdet_avp/")]


def test_a_checkout_has_no_folder_that_would_be_taken_for_an_installed_one():
    assert not (REPOSITORY / "pcdet_avp" / "_data").exists()


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """An empty folder, and beside it an environment with the wheel, whose dependencies are this environment's."""
    top = tmp_path_factory.mktemp("wheel")
    names = subprocess.run(["git", "ls-files", "-z"], cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout
    for name in filter(None, names.split("\0")):  # a copy: building leaves files behind, and may find old ones
        (top / "source" / name).parent.mkdir(parents=True, exist_ok=True)
        (top / "source" / name).write_bytes((REPOSITORY / name).read_bytes())
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check")
    subprocess.run([*pip, "wheel", "-q", "--no-deps", "-w", str(top), str(top / "source")], check=True)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(top / "v")], check=True)
    (site,) = (top / "v").glob("lib/python*/site-packages")
    # A line of a .pth file adds a folder and nothing of that folder's own .pth files: no editable installation of ours.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    (wheel,) = top.glob("*.whl")
    subprocess.run([*pip, "--python", str(top / "v"), "install", "-q", "--no-deps", str(wheel)], check=True)
    (top / "work").mkdir()
    return top


@pytest.fixture(scope="module")
def call(place):
    """``call(script, *arguments)`` in the empty folder: what it printed."""
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME")}

    def run(script, *arguments):
        command = [str(place / "v" / "bin" / script), *map(str, arguments)]
        done = subprocess.run(
            command, cwd=place / "work", capture_output=True, text=True, env=environment, check=False, timeout=1800
        )
        assert done.returncode == 0, done.stderr
        return done.stdout + done.stderr

    return run


def contents(folder):
    return {file for file in folder.rglob("*") if "__pycache__" not in file.parts}


@pytest.mark.slow
def test_a_wheel_makes_data_and_tests_its_weights_in_an_empty_folder(place, call):
    where = call("python", "-c", "from pcdet_avp import shipped; print(shipped.INSTALLED, shipped.ROOT)")
    (root,) = (place / "v").glob("lib/python*/site-packages/pcdet_avp/_data")
    assert where.strip() == f"True {root}"
    before = contents(root.parent)
    call("avp-data", *SMALL, "--frames", 20)
    said = call("avp-test", *SMALL, "--combos", "C+none,CL+CL")
    assert f"taking the weights that come with the package, {root / 'weights' / 'cp_small.pth'}" in said
    result = json.loads(next((place / "work" / "output").rglob("result.json")).read_text())
    assert result["meta"]["command"] == "avp-test --cfg cfgs/avp/cp_small.yaml --combos C+none,CL+CL"
    ap = {row["combo"]: row["Car"]["overall"]["0.7"] for row in result["rows"] if row["region"] == "camera_fov"}
    assert ap["CL+CL"] > 80 > 60 > ap["C+none"]  # trained weights, and the roadside helps
    assert (place / "work" / "data" / "avp_small" / "dataset.json").exists()
    assert contents(root.parent) == before
    assert {path.name for path in (place / "work").iterdir()} == {"data", "output"}


@pytest.mark.slow
def test_an_installed_package_drives_and_records_videos(place, call):
    what = ("--scenario", "t_junction", "--perception", "oracle", "--speeds", 6, "--trials", 2)
    assert "t_junction oracle any" in call("avp-safety", *what)
    assert (place / "work" / "output" / "safety_eval" / "t_junction_oracle" / "summary.json").exists()
    pytest.importorskip("gymnasium")
    pytest.importorskip("moviepy")
    call("python", "-c", VIDEO)
    (video,) = (place / "work" / "videos").glob("*.mp4")
    assert video.stat().st_size > 1000
