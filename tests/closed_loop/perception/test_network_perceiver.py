"""The network in the loop, untrained and tiny: what reaches the vehicle, and what is left when the roadside is cut."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pcdet_avp.closed_loop.perception.link_options import LinkOptions
from pcdet_avp.closed_loop.perception.network import untrained
from pcdet_avp.closed_loop.perception.network_perceiver import NetworkPerceiver, drawn_error, rig_as_read
from pcdet_avp.closed_loop.perception.roadside_unit import RoadsideUnit
from pcdet_avp.closed_loop.perception.vehicle_unit import Onboard
from pcdet_avp.config import apply_overrides, load_config
from pcdet_avp.datasets.avp.collate import collate, load_batch
from pcdet_avp.datasets.avp.prepare import prepare
from pcdet_avp.errors import ConfigError
from pcdet_avp.generate import scene_config
from pcdet_avp.models.compression.map_packets import as_latent
from pcdet_avp.models.compression.wire import Wire
from pcdet_avp.sim.rays.lidar import LidarNoise
from pcdet_avp.sim.rig import Rig, capture, observe
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SOURCES, SensorSet

CFG_FILE = Path(__file__).parents[3] / "cfgs" / "avp" / "cp_tiny.yaml"
CFG = load_config(CFG_FILE)
SCENARIO, KEY = SimpleNamespace(name="test", trial=3, reversing=False), (5, 1)
TICK_S = 0.05


@pytest.fixture(scope="module")
def rig(driving):
    return rig_as_read(driving)


@pytest.fixture(scope="module")
def scene():
    return draw_training_scene(np.random.default_rng(3), scene_config(CFG.DATA_CONFIG.GENERATE))


def at_tick(scene, tick):
    """The scene's world with an ego that drives on at 8 m/s."""
    world = scene.seek(0)
    world.advance_to(TICK_S * tick)
    world.set_ego(world.world_from_ego.translation[0] + 0.4 * tick, world.layout.lane_y, 0.0)
    return world


def drive(driving, scene, combos, key=KEY, **options):
    """What is perceived in as many ticks as there are combinations."""
    perceiver = NetworkPerceiver(driving, LinkOptions(**options))
    perceiver.begin(SCENARIO, key)
    return [perceiver.perceive(at_tick(scene, t), t, SENSOR_SETS[combo]) for t, combo in enumerate(combos)]


def same(a, b):
    """Whether two results agree bit for bit."""
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("boxes", "names", "scores"))


@pytest.mark.parametrize("combo", SENSOR_SETS)
def test_the_loop_finds_what_the_test_tool_finds_in_the_same_frame(driving, rig, scene, combo):
    found = drive(driving, scene, [combo])[0]
    frame = capture(at_tick(scene, 0), rig, (*KEY, 0), "0/0")
    batch = load_batch(collate([prepare(frame, SENSOR_SETS[combo], driving.input.prepare_config)]), "cpu")
    with torch.no_grad():
        expected = driving.network(batch, link=Wire(driving.network.codec))[0][0]
    assert len(found.boxes) > 10
    np.testing.assert_allclose(found.scores, expected["pred_scores"], atol=1e-5)
    np.testing.assert_allclose(found.boxes, expected["pred_boxes"], atol=1e-3)


def test_half_of_a_turn_is_all_that_the_vehicle_s_map_holds(driving, rig, scene):
    whole = Rig.from_config(CFG.DATA_CONFIG.SENSORS).ego
    assert rig.ego.lidar.columns == whole.lidar.columns // 2
    world, points = at_tick(scene, 0), []
    for sensors in (whole, rig.ego):
        noiseless = replace(rig, ego=replace(sensors, lidar_noise=LidarNoise(0.0, 0.0, False)))
        frame = observe(world, noiseless, KEY, "0/0", ["ego_lidar"])
        rows = prepare(frame, SensorSet(False, True, False, False), driving.input.prepare_config)["points"]
        points.append(rows[np.lexsort(rows.T)])
    assert len(points[0]) > 1000
    np.testing.assert_allclose(points[1], points[0], atol=1e-4)


def test_corrections_by_registration_are_remembered_for_one_episode(scene):
    cfg = apply_overrides(load_config(CFG_FILE), ["MODEL.REGISTRATION.ENABLED", "True"])
    perceiver, memories = NetworkPerceiver(untrained(cfg), LinkOptions(position_noise_m=0.5)), []
    for _ in range(2):
        perceiver.begin(SCENARIO, KEY)
        perceiver.perceive(at_tick(scene, 0), 0, SENSOR_SETS["CL+CL"])
        memories.append(perceiver._vehicle._half._memory["correction_memory"])
    assert memories[0] is not memories[1]
    off = Onboard(untrained(CFG), 0.3)
    assert not off._half._memory


def test_bf16_finds_nearly_the_same(driving, scene, monkeypatch):
    exact = drive(driving, scene, ["CL+CL"])[0]
    monkeypatch.setattr(driving.network, "precision", "bf16")
    rough = drive(driving, scene, ["CL+CL"])[0]
    assert not same(exact, rough)
    np.testing.assert_allclose(rough.scores[:100], exact.scores[:100], rtol=0.05)


@pytest.mark.parametrize("precision", ["float32", "bf16"])
def test_two_threads_find_the_same(driving, scene, monkeypatch, precision):
    """The encoders then run side by side; inside an operation the order of sums may change."""
    monkeypatch.setattr(driving.network, "precision", precision)
    alone = drive(driving, scene, ["CL+CL"])[0]
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        together = drive(driving, scene, ["CL+CL"])[0]
    finally:
        torch.set_num_threads(threads)
    np.testing.assert_allclose(together.scores, alone.scores, atol=1e-5 if precision == "float32" else 0.01)


def test_messages_tell_size_and_age(driving, scene):
    in_time, (first, second) = drive(driving, scene, ["C+CL"])[0], drive(driving, scene, ["C+C"] * 2, link="nr_v2x")
    assert [(m.source, m.age_s) for m in in_time.messages] == [("infra_camera", 0.0), ("infra_lidar", 0.0)]
    assert all(500 < m.bytes < 10_000 for m in in_time.messages)
    assert first.messages == ()  # still on its way
    assert [(m.source, m.age_s) for m in second.messages] == [("infra_camera", 0.05)]


@pytest.mark.parametrize(("seed", "link"), [(0, "ideal"), (1, "nr_v2x")])
def test_the_roadside_is_cut_at_any_tick(driving, scene, seed, link):
    """Held maps are used until they expire; then all is bit for bit as if there had never been a roadside."""
    cut, hold = int(np.random.default_rng(seed).integers(1, 4)), 2
    combos = ["CL+CL"] * cut + ["CL+none"] * 5
    alone = drive(driving, scene, ["CL+none"] * len(combos))
    found = drive(driving, scene, combos, link=link, hold_ms=hold * 1e3 * TICK_S)
    late = link == "nr_v2x"  # by a tick
    with_messages = [t for t, perceived in enumerate(found) if perceived.messages]
    assert with_messages == list(range(late, cut + hold))
    for tick, (perceived, expected) in enumerate(zip(found, alone, strict=True)):
        assert same(perceived, expected) == (tick not in with_messages), tick


def test_the_roadside_falls_silent_at_a_time_drawn_per_episode(driving, scene):
    last = []
    for key in ((5, 1), (5, 2), (5, 3)):
        found = drive(driving, scene, ["C+C"] * 7, key, cut_within_s=0.3, hold_ms=0)
        heard = [bool(perceived.messages) for perceived in found]
        last.append(sum(heard))
        assert heard == [tick < last[-1] for tick in range(7)]
    assert min(last) >= 1
    assert len(set(last)) > 1


def test_a_link_that_loses_everything_is_no_roadside(driving, scene):
    found = drive(driving, scene, ["C+CL"] * 2, link="nr_v2x", block_loss=1.0)
    alone = drive(driving, scene, ["C+none"] * 2)
    assert all(same(a, b) for a, b in zip(found, alone, strict=True))


def test_results_do_not_depend_on_what_the_process_did_before(driving, scene):
    lossy = {"link": "nr_v2x", "block_loss": 0.3, "position_noise_m": 0.2}
    expected = drive(driving, scene, ["C+C"] * 3, **lossy)
    perceiver = NetworkPerceiver(driving, LinkOptions(**lossy))
    for key in ((9, 9), KEY):  # another episode first
        perceiver.begin(SCENARIO, key)
        found = [perceiver.perceive(at_tick(scene, t), t, SENSOR_SETS["C+C"]) for t in range(3)]
    assert all(same(a, b) and a.messages == b.messages for a, b in zip(found, expected, strict=True))


def test_the_unit_knows_nothing_of_the_vehicle_s_sensors(driving, rig, scene):
    unit = RoadsideUnit(driving, 60_000)
    everything = observe(at_tick(scene, 0), rig, KEY, "0/0", SOURCES)
    its_own = observe(at_tick(scene, 0), rig, KEY, "0/0", SOURCES[2:])
    assert its_own.ego.image is None
    assert unit.packets(everything, True, True, 0) == unit.packets(its_own, True, True, 0)


def test_an_old_map_is_placed_by_where_the_vehicle_is_now(driving, rig, scene):
    onboard, unit = Onboard(driving, 1.0), RoadsideUnit(driving, 60_000)
    for payloads in unit.packets(observe(at_tick(scene, 0), rig, KEY, "0/0", SOURCES), True, True, 0).values():
        onboard.hear(payloads)
    now = observe(at_tick(scene, 10), rig, KEY, "0/10", SOURCES)
    held = onboard.held(now.time_s)
    found = onboard.run(now, True, False, now.ego.world_from_agent, held)
    sample = prepare(now, SensorSet.parse("C+CL"), driving.input.prepare_config)  # has the pose of this very frame
    latents = {f"infra_{key.modality}": as_latent(known) for key, known in held.items()}
    with torch.no_grad():
        expected = driving.network.run_stages(load_batch(collate([sample]), "cpu"), link=lambda _: latents)
    torch.testing.assert_close(found["spatial_features"], expected["spatial_features"], atol=1e-4, rtol=1e-4)


def test_damaged_segments_never_came(driving, rig, scene):
    onboard = Onboard(driving, 1.0)
    packets = RoadsideUnit(driving, 60_000).packets(
        observe(at_tick(scene, 0), rig, KEY, "0/0", SOURCES[2:]), True, True, 0
    )
    onboard.hear(bytes([*payload[:50], payload[50] ^ 1, *payload[51:]]) for p in packets.values() for payload in p)
    onboard.hear([b"", b"noise"])
    assert onboard.held(0.0) == {}


def test_an_error_of_the_vehicle_s_pose_moves_the_map_by_as_much():
    options = LinkOptions(position_noise_m=0.5, yaw_noise_deg=2.0)
    errors = [drawn_error(options, np.random.default_rng(seed)) for seed in range(400)]
    assert np.std([e.translation[:2] for e in errors]) == pytest.approx(0.5, rel=0.1)
    assert np.degrees(np.std([e.yaw for e in errors])) == pytest.approx(2.0, rel=0.1)
    assert np.array_equal(drawn_error(LinkOptions(), np.random.default_rng(0)).matrix, Pose.identity().matrix)


def test_maps_without_compression_cannot_be_sent():
    cfg = load_config(Path(__file__).parents[3] / "cfgs" / "avp" / "cp_tiny.yaml")
    cfg.MODEL.COMPRESSION.NAME = "NoCompression"
    with pytest.raises(ConfigError, match=r"--perception model: .*no bytes"):
        NetworkPerceiver(untrained(cfg), LinkOptions())


def test_a_vehicle_that_reverses_has_no_camera_and_a_lidar_that_looks_where_it_goes(driving, scene):
    """Its whole turn of columns is cast: the half that lies ahead is not the one that ``rig_as_read`` keeps."""
    perceiver = NetworkPerceiver(driving, LinkOptions())
    perceiver.begin(SimpleNamespace(name="test", trial=3, reversing=True), KEY)
    assert len(perceiver.perceive(at_tick(scene, 0), 0, SENSOR_SETS["C+none"]).boxes) == 0
    found = perceiver.perceive(at_tick(scene, 1), 1, SENSOR_SETS["CL+none"])
    rig = Rig.from_config(driving.sensors).reversed()
    frame = observe(at_tick(scene, 1), rig, (*KEY, 1), "1", ["ego_lidar"])
    seen = Onboard(driving, 0.3).detect(frame, False, True, frame.ego.world_from_agent, {})
    assert len(found.boxes) > 10
    assert same(found, seen)


def test_with_its_own_sensors_dead_a_vehicle_has_the_roadside_s_maps_and_then_nothing(driving, scene):
    perceiver = NetworkPerceiver(driving, LinkOptions())
    perceiver.begin(SCENARIO, KEY)
    assert len(perceiver.perceive(at_tick(scene, 0), 0, SensorSet(False, False, True, True)).boxes) > 0
    perceiver.begin(SCENARIO, KEY)
    assert len(perceiver.perceive(at_tick(scene, 0), 0, SensorSet(False, False, False, False)).boxes) == 0


def test_without_the_rows_that_the_network_cuts_off_it_finds_the_same(scene):
    cfg = load_config(CFG_FILE)
    cfg.MODEL.CAMERA_ENCODER.CROP_TOP_PX = {"ego": 28, "infra": 16}
    driving = untrained(cfg)
    rig = rig_as_read(driving)
    assert (rig.ego.first_row, rig.infra.first_row) == (28, 16)
    part, whole = (drive(d, scene, ["C+C"])[0] for d in (driving, replace(driving, first_rows={})))
    assert same(part, whole)
    assert len(part.boxes) > 0
    cfg.DATA_CONFIG.SENSORS.EGO.CAMERA.HEIGHT = 216  # its images are resized before they are cut
    assert rig_as_read(untrained(cfg)).ego.first_row == 0
