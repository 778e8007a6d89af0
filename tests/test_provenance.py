"""Where a number comes from."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

from pcdet_avp import provenance
from pcdet_avp.config import config_hash

REPOSITORY = Path(__file__).parents[1]


def test_a_result_says_all_that_is_needed_to_make_it_again(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["tools/test.py", "--cfg", "a b.yaml"])
    meta = provenance.provenance({"A": 1}, "cp_tiny", seed=3, weights_hash="00ff", started=0.0)
    assert {"config", "config_hash", "command", "versions", "git_commit", "seed", "weights_hash"} <= set(meta)
    assert meta["config_hash"] == config_hash({"A": 1})
    assert meta["command"].endswith("tools/test.py --cfg 'a b.yaml'")
    assert meta["wall_time_s"] > 1e9
    assert {"python", "pcdet_avp", "torch", "numpy"} <= set(meta["versions"])
    json.dumps(meta, allow_nan=False)


def test_a_console_script_is_named_without_its_folder(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["/home/me/env/bin/avp-test", "--cfg", "c.yaml"])
    assert provenance.command() == "avp-test --cfg c.yaml"
    monkeypatch.setattr(sys.modules["__main__"], "__spec__", SimpleNamespace(name="pcdet_avp.commands.test"))
    monkeypatch.setattr(sys, "argv", ["/home/me/env/lib/pcdet_avp/commands/test.py", "--wire"])
    assert provenance.command() == f"{Path(sys.executable).name} -m pcdet_avp.commands.test --wire"


def test_the_commit_is_the_packages_wherever_one_stands(monkeypatch, tmp_path):
    expected = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=REPOSITORY, capture_output=True, text=True, check=False
    ).stdout.strip()
    monkeypatch.chdir(tmp_path)
    found = provenance.git_commit()
    assert (found or "").removesuffix("+changed") == expected


def test_a_package_outside_of_a_checkout_has_no_commit(monkeypatch, tmp_path):
    monkeypatch.setattr(provenance.pcdet_avp, "__file__", str(tmp_path / "__init__.py"))
    assert provenance.git_commit() is None


def test_a_package_installed_below_someone_elses_checkout_has_no_commit(monkeypatch, tmp_path):
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    (tmp_path / "__init__.py").touch()
    monkeypatch.setattr(provenance.pcdet_avp, "__file__", str(tmp_path / "__init__.py"))
    assert provenance.git_commit() is None
