"""An environment without torch, installed by the command of docs/deploy.md, sends packets that vehicle.py accepts."""

import os
import re
import socket
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
COMMANDS = re.findall(r"^pip install (.*)$", (ROOT / "requirements-deploy.txt").read_text().replace("#   ", ""), re.M)


def test_the_command_of_the_page_is_that_of_the_file():
    page = (ROOT / "docs" / "deploy.md").read_text()
    assert len(COMMANDS) == 2
    assert all(f"pip install {command}" in page for command in COMMANDS)


def test_the_list_holds_what_the_package_names_without_torch():
    text = (ROOT / "pyproject.toml").read_text()
    lines = [line for line in (ROOT / "requirements-deploy.txt").read_text().splitlines() if not line.startswith("#")]
    assert all(f'"{line}"' in text for line in lines)
    assert not any(line.startswith("torch") for line in lines)


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """The interpreter of a new environment."""
    folder = tmp_path_factory.mktemp("without_torch") / "venv"
    venv.create(folder, with_pip=True)
    for command in COMMANDS:
        install = [folder / "bin" / "pip", "install", "--quiet", *command.replace(" .", f" {ROOT}").split()]
        done = subprocess.run(install, cwd=ROOT, capture_output=True, text=True, check=False)
        if "Could not find a version" in done.stderr or "Connection" in done.stderr:
            pytest.skip(f"no package index within reach: {done.stderr.strip().splitlines()[-1][:120]}")
        assert done.returncode == 0, done.stderr
    return folder / "bin" / "python"


@pytest.mark.slow
def test_packets_of_a_roadside_unit_without_torch_are_fused(python, exported, to_export, tmp_path):
    missing = subprocess.run([python, "-c", "import torch"], capture_output=True, cwd=tmp_path, check=False)
    assert missing.returncode != 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        place = f"127.0.0.1:{probe.getsockname()[1]}"
    data = ("--set", "DATA_CONFIG.DATA_PATH", str(to_export.dataset.root_path))
    common = ("--cfg", str(to_export.cfg_file), "--frames", "1")
    vehicle = _start(sys.executable, "vehicle", "--listen", place, "--ckpt", str(to_export.path), "--seconds", "2",
                     "--wait", "200", "--max_age", "60", *common, *data)  # fmt: skip
    roadside = _start(python, "roadside_unit", "--to", place, "--runtime", "onnxruntime", "--exported", str(exported),
                      "--seconds", "240", *common, *data)  # fmt: skip
    try:
        printed, errors = vehicle.communicate(timeout=300)
        assert vehicle.returncode == 0, (errors, roadside.poll() and roadside.communicate())
        assert int(re.search(r"segments: (\d+) accepted", printed)[1]) >= 2
        assert re.search(r"all: .* [\d.]+ boxes", printed)
    finally:
        for process in (vehicle, roadside):
            process.kill()
            process.communicate()


def _start(interpreter, role, *arguments):
    where = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": "" if interpreter != sys.executable else str(ROOT)}
    words = [str(interpreter), str(ROOT / "examples" / f"{role}.py"), *arguments]
    return subprocess.Popen(words, env=where, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
