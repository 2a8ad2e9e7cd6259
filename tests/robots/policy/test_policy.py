import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from demonstration_sets import touching, write_episodes
from draccus.utils import DecodingError
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy
from lerobot.utils.constants import ACTION, OBS_STATE
from safetensors.torch import load_file, save_file

from lerobot_robot_pneutac.lerobot_inside import prepare
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import TACTILE, PneutacBCConfig
from lerobot_robot_pneutac.policy.modeling_pneutac_bc import PneutacBCPolicy, Scaling
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_HIGH, ACTION_LOW, IMAGE_SHAPE, STATE_NAMES

CONTACT = [STATE_NAMES.index("contact_area.pos"), STATE_NAMES.index("contact_pixels.pos")]


@pytest.fixture(autouse=True)
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    yield
    torch.set_num_threads(threads)


def make_config(image=(3, 320, 240), **kwargs) -> PneutacBCConfig:
    inputs = {OBS_STATE: PolicyFeature(FeatureType.STATE, (20,))}
    if image:
        inputs[TACTILE] = PolicyFeature(FeatureType.VISUAL, image)
    outputs = {ACTION: PolicyFeature(FeatureType.ACTION, (4,))}
    return PneutacBCConfig(device="cpu", input_features=inputs, output_features=outputs, **kwargs)


def make_ready_policy(**kwargs) -> PneutacBCPolicy:
    policy = PneutacBCPolicy(make_config(**kwargs))
    if policy.encoder is not None:
        policy.encoder.rest_image.fill_(0.4)
    return policy


def make_batch(n=3) -> dict:
    g = torch.Generator().manual_seed(1)
    low, high = torch.tensor(ACTION_LOW), torch.tensor(ACTION_HIGH)
    return {
        OBS_STATE: 0.3 * torch.rand(n, 20, generator=g),
        TACTILE: torch.rand(n, 3, 320, 240, generator=g),
        ACTION: low + (high - low) * torch.rand(n, 2, 4, generator=g),
        "action_is_pad": torch.zeros(n, 2, dtype=torch.bool),
    }


def write_dataset(root, levels, fps=15, state_names=STATE_NAMES, shape=IMAGE_SHAPE):
    """A dataset with one episode of two frames for each level: a grey first image and a white second one."""
    touch = touching(0.1, state_names)
    episodes = [[(touch, 0, level), (touch, 0, 255)] for level in levels]
    write_episodes(root, episodes, state_names, fps, shape)
    return LeRobotDatasetMetadata(f"local/{root.name}", root)


# ---------------------------------------------------------------- options and features


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"previous_action_dropout": 1.5}, "previous_action_dropout is 1.5"),
        ({"optimizer_lr": 0.0}, "optimizer_lr is 0.0"),
        ({"networks": 0}, "networks is 0"),
        ({"networks": 3000}, "networks is 3000; it must be 1 or more and at most 100"),
        ({"normalization_mapping": {"STATE": NormalizationMode.MEAN_STD}}, "must be IDENTITY"),
    ],
)
def test_bad_options_are_named(options, said):
    with pytest.raises(DecodingError, match=said):
        make_config(**options)


def test_features_that_do_not_fit_are_named():
    with pytest.raises(InputError, match=r"tactile' has the shape \(1, 320, 240\)"):
        PneutacBCPolicy(make_config(image=(1, 320, 240)))
    with pytest.raises(InputError, match="use_tactile=false"):
        PneutacBCPolicy(make_config(image=None))
    config = make_config()
    config.output_features = {ACTION: PolicyFeature(FeatureType.ACTION, (5,))}
    with pytest.raises(InputError, match=r"'action' has the shape \(5,\)"):
        PneutacBCPolicy(config)


def test_datasets_that_do_not_fit_are_named(tmp_path):
    with pytest.raises(InputError, match="30 frames per second"):
        make_policy(
            PneutacBCConfig(device="cpu", control_hz=15), write_dataset(tmp_path / "fast", [100], fps=30)
        )
    swapped = [STATE_NAMES[1], STATE_NAMES[0], *STATE_NAMES[2:]]
    with pytest.raises(InputError, match=r"'observation.state' has the names \['joint_2.pos', 'joint_1.pos'"):
        make_policy(PneutacBCConfig(device="cpu"), write_dataset(tmp_path / "a", [100], state_names=swapped))


def test_images_keep_their_size_and_weights_of_another_size_are_named(tmp_path):
    mini = write_dataset(tmp_path / "mini", [100, 120], shape=(240, 320, 3))
    policy = make_policy(PneutacBCConfig(device="cpu"), mini)
    assert policy.encoder.rest_image.shape == (3, 240, 320)
    batch = make_batch(2) | {TACTILE: torch.rand(2, 3, 240, 320), "index": torch.tensor([0, 3])}
    loss, _ = policy.forward(batch)
    loss.backward()
    assert policy.encoder.layers[0].weight.grad.abs().max() > 0
    policy.save_pretrained(tmp_path / "policy")
    assert "320 x 240 pixels" in (tmp_path / "policy" / "README.md").read_text()
    path = tmp_path / "policy"
    assert PreTrainedConfig.from_pretrained(path).instructions == list(mini.tasks.index)
    tuned = make_policy(PneutacBCConfig(device="cpu", pretrained_path=path), mini)
    assert tuned.encoder.rest_image.shape == (3, 240, 320)
    digit = write_dataset(tmp_path / "digit", [100])
    said = "safetensors: the tactile images are 320 x 240 px and this policy takes 240 x 320; give the camera"
    with pytest.raises(InputError, match=said):
        make_policy(PneutacBCConfig(device="cpu", pretrained_path=path), digit)
    with pytest.raises(
        InputError, match="'local/digit': the tactile images are 240 x 320 px and this policy"
    ):
        make_policy(PreTrainedConfig.from_pretrained(path), digit)


# ---------------------------------------------------------------- loss


def test_loss_is_the_papers_formula(monkeypatch):
    policy = make_ready_policy().eval()
    batch = make_batch(2)
    batch[ACTION][:, 1] = torch.tensor([[0.03, 0.0, -0.015, 5.0], [0.0, 0.0, 0.0, 2.0]])
    predicted = torch.tensor([[[0.0, 0.0, 0.0, 7.0], [0.06, 0.0, 0.0, 2.0]]])
    monkeypatch.setattr(policy, "_predict", lambda *_: predicted)
    loss, terms = policy(batch)
    # Displacements at 15 Hz in mm: (2, 0, -1) missed in the first sample, 4 too much in the second.
    assert loss.item() == pytest.approx((4 + 1 + 16) / 2 + 4 / 2, rel=1e-5)
    assert terms == pytest.approx({"motion_mm2": 10.5, "pressure_kpa2": 2.0}, rel=1e-5)
    policy.config.huber_delta = (
        1.5  # 2 and 4 mm count 1.5 (2 * 2 - 1.5) and 1.5 (2 * 4 - 1.5), 1 mm its square
    )
    _, terms = policy(batch)
    assert terms == pytest.approx({"motion_mm2": (3.75 + 1 + 9.75) / 2, "pressure_kpa2": 3.75 / 2}, rel=1e-5)


def test_previous_action_counts_only_where_there_is_one():
    policy = make_ready_policy().eval()
    batch = make_batch()
    other = {**batch, ACTION: batch[ACTION].clone()}
    other[ACTION][:, 0] = torch.tensor(ACTION_HIGH)
    assert policy(batch)[0] != policy(other)[0]
    for b in (batch, other):
        b["action_is_pad"] = torch.tensor([[True, False]] * 3)
    assert policy(batch)[0] == policy(other)[0]


def test_dropout_hides_the_previous_action_in_training_only():
    policy = make_ready_policy(
        previous_action_dropout=1.0,
        pressure_noise_kpa=0.0,
        brightness_noise_levels=0.0,
        pixel_noise_levels=0.0,
    )
    batch = make_batch()
    other = {**batch, ACTION: batch[ACTION].clone()}
    other[ACTION][:, 0] = torch.tensor(ACTION_HIGH)
    policy.train()
    assert policy(batch)[0] == policy(other)[0]
    policy.eval()
    assert policy(batch)[0] != policy(other)[0]


def test_noise_on_images_is_of_pixels_and_of_brightness_in_training_only():
    batch = make_batch()
    state, previous = batch[OBS_STATE], torch.zeros(len(batch[OBS_STATE]), 4)
    hidden = torch.zeros(len(state), dtype=torch.bool)
    still = torch.zeros(len(state), 3, 80, 60)
    for levels, training, (pixels, brightness) in (
        ((1.0, 0.0), True, (0.577, 0.0)),  # root of the mean of u^2, u uniform in [0, 1]
        ((0.0, 3.0), True, (0.0, 3.0)),
        ((1.0, 3.0), False, (0.0, 0.0)),
    ):
        policy = make_ready_policy(pixel_noise_levels=levels[0], brightness_noise_levels=levels[1])
        policy.train(training)
        seen = []
        policy.encoder.register_forward_pre_hook(lambda _, given, seen=seen: seen.append(32 * given[0]))
        torch.manual_seed(0)
        for _ in range(200):
            policy.loss(state, previous, hidden, previous, still, None)
        seen = torch.cat(seen)
        mean = seen.mean((2, 3), keepdim=True)
        assert mean.square().mean().sqrt() == pytest.approx(brightness, rel=0.06, abs=0.02)
        assert (seen - mean).square().mean().sqrt() == pytest.approx(pixels, rel=0.06, abs=1e-6)


@pytest.mark.parametrize("steps", [40, 1000])
def test_the_learning_rate_falls_to_zero_with_the_last_step(steps):
    policy = make_ready_policy(optimizer_lr=2e-4)
    optimiser = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    scheduler = policy.config.get_scheduler_preset().build(optimiser, steps)
    rates = []
    for _ in range(steps):
        rates.append(optimiser.param_groups[0]["lr"])
        optimiser.step()
        scheduler.step()
    assert rates[0] == pytest.approx(2e-4) and rates[steps // 2] == pytest.approx(1e-4, rel=0.1)
    assert optimiser.param_groups[0]["lr"] < 1e-8 and np.all(np.diff(rates) <= 0)


def test_a_loss_that_is_not_finite_stops_the_training():
    batch = make_batch()
    batch[OBS_STATE][1, 3] = torch.nan
    with pytest.raises(InputError, match="dataset contains NaN"):
        make_ready_policy()(batch)


def test_overfits_one_batch():
    policy = make_ready_policy(pressure_noise_kpa=0.0, previous_action_dropout=0.0).train()
    batch = make_batch()
    preset = policy.config.get_optimizer_preset()
    assert preset.lr == 3e-4
    optimizer = preset.build(policy.get_optim_params())
    first = policy(batch)[0].item()
    for _ in range(120):
        loss, _ = policy(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert policy(batch)[0].item() < 0.01 * first


@pytest.mark.parametrize("use_tactile", [True, False])
def test_several_networks_act_by_their_mean_and_learn_each_for_itself(tmp_path, use_tactile):
    policy = make_ready_policy(networks=3, use_tactile=use_tactile).eval()
    batch = make_batch()
    state, previous = batch[OBS_STATE], batch[ACTION][:, 0]
    each = policy._predict(state, policy._difference(batch), previous, None)
    assert each.shape == (3, 3, 4) and each.std(0).min() > 0
    policy._previous = previous
    mean = each.mean(0).clamp(policy._action_low, policy._action_high)
    torch.testing.assert_close(policy.select_action(batch), mean)
    errors = (each - batch[ACTION][:, 1]) * torch.tensor([1000 / 15] * 3 + [1.0])
    assert policy(batch)[0].item() == pytest.approx(errors.square().sum(-1).mean().item(), rel=1e-5)
    policy.save_pretrained(tmp_path)
    again = PneutacBCPolicy.from_pretrained(tmp_path)
    again._previous = previous
    torch.testing.assert_close(again.select_action(batch), mean)


# ---------------------------------------------------------------- inference


def test_remembers_its_action_until_reset():
    policy = make_ready_policy()
    batch = make_batch()
    first, second = policy.select_action(batch), policy.select_action(batch)
    assert not torch.equal(first, second)
    policy.reset()
    assert torch.equal(policy.select_action(batch), first)
    assert torch.equal(policy.select_action(batch), second)


def test_actions_stay_within_the_limits():
    policy = make_ready_policy()
    with torch.no_grad():
        policy.mlp[-1].weight.mul_(1000)
    actions = policy.select_action(make_batch(8))
    low, high = torch.tensor(ACTION_LOW), torch.tensor(ACTION_HIGH)
    assert ((actions >= low) & (actions <= high)).all()
    assert ((actions == low) | (actions == high)).any()


def test_bad_observations_are_named():
    policy = make_ready_policy()
    batch = make_batch(1)
    with pytest.raises(InputError, match="not finite"):
        policy.select_action({**batch, OBS_STATE: torch.full((1, 20), torch.nan)})
    with pytest.raises(InputError, match=r"state has the shape \(14,\)"):
        policy.select_action({**batch, OBS_STATE: torch.zeros(1, 14)})
    with pytest.raises(InputError, match=r"image has the shape \(3, 240, 320\)"):
        policy.select_action({**batch, TACTILE: torch.zeros(1, 3, 240, 320)})
    with pytest.raises(InputError, match="has no 'observation.images.tactile'"):
        policy.select_action({OBS_STATE: batch[OBS_STATE]})
    with pytest.raises(InputError, match="no rest image"):
        PneutacBCPolicy(make_config()).select_action(batch)


def test_without_touch_neither_image_nor_contact_matter():
    policy = make_ready_policy(use_tactile=False)
    assert TACTILE not in policy.config.input_features
    batch = make_batch()
    touched = batch[OBS_STATE].clone()
    touched[:, CONTACT] += 1
    action = policy.select_action({OBS_STATE: batch[OBS_STATE]})
    policy.reset()
    assert torch.equal(policy.select_action({OBS_STATE: touched, TACTILE: batch[TACTILE]}), action)

    with_touch = make_ready_policy()
    action = with_touch.select_action(batch)
    with_touch.reset()
    assert not torch.equal(with_touch.select_action({**batch, OBS_STATE: touched}), action)


# ---------------------------------------------------------------- rest image


def test_rest_image_is_the_median_of_first_frames(tmp_path):
    policy = make_policy(PneutacBCConfig(device="cpu"), write_dataset(tmp_path / "a", [100, 102, 250]))
    assert torch.allclose(policy.encoder.rest_image, torch.tensor(102 / 255), atol=1e-6)


def test_fine_tuning_keeps_the_weights_and_takes_the_new_rest_image(tmp_path):
    first = make_policy(PneutacBCConfig(device="cpu"), write_dataset(tmp_path / "a", [100]))
    first.save_pretrained(tmp_path / "policy")

    config = PreTrainedConfig.from_pretrained(tmp_path / "policy")
    config.pretrained_path = tmp_path / "policy"
    second = make_policy(config, write_dataset(tmp_path / "b", [140]))
    assert torch.allclose(second.encoder.rest_image, torch.tensor(140 / 255), atol=1e-6)
    for a, b in zip(first.parameters(), second.parameters(), strict=True):
        assert torch.equal(a, b)

    alone = PneutacBCPolicy.from_pretrained(tmp_path / "policy")
    assert torch.allclose(alone.encoder.rest_image, torch.tensor(100 / 255), atol=1e-6)
    batch = make_batch()
    first.reset()
    assert torch.equal(alone.select_action(batch), first.select_action(batch))


def test_a_dataset_of_another_finger_scales_and_limits_the_pressure():
    rows = {"min": np.full(20, 0.2), "max": np.full(20, 0.6)}
    stats = {"observation.state": rows, "action": {"min": [-0.1, 0, 0, -30.0], "max": [0.1, 0, 0, 60.0]}}
    s = Scaling.of(stats)
    assert (s.action_low[3], s.action_high[3], s.action_centre[3], s.action_scale[3]) == (-30, 60, 15, 45)
    assert (s.state_centre[19], s.state_scale[19]) == (15, 45)
    np.testing.assert_allclose(s.state_centre[[0, 14]], 0.4)  # where its arm stood
    np.testing.assert_array_equal(s.state_centre[7:14], 0.0)
    np.testing.assert_allclose(s.action_low[:3], -0.1)  # velocities reach as far as the robot does


@pytest.mark.parametrize("gone", ["_state_scale", "encoder.rest_image", "mlp.0.weight"])
def test_a_checkpoint_that_lacks_something_is_refused(tmp_path, gone):
    make_ready_policy().save_pretrained(tmp_path)
    file = tmp_path / "model.safetensors"
    save_file({k: v for k, v in load_file(file).items() if k != gone}, file)
    with pytest.raises(InputError, match=rf"model.safetensors'.*differs in {gone}\)"):
        PneutacBCPolicy.from_pretrained(tmp_path)


def test_weights_of_another_body_are_named(tmp_path):
    make_ready_policy().save_pretrained(tmp_path)
    arm = make_config()
    arm.input_features[OBS_STATE] = PolicyFeature(FeatureType.STATE, (22,))
    arm.output_features[ACTION] = PolicyFeature(FeatureType.ACTION, (6,))
    with pytest.raises(InputError, match="on 20 numbers of state and 4 of action, and here are 22 and 6"):
        PneutacBCPolicy.from_pretrained(tmp_path, config=arm)


def cut(file):
    file.write_bytes(file.read_bytes()[:-9])


def changed(**fields):
    def change(file):
        file.write_text(json.dumps(json.loads(file.read_text()) | fields))

    return change


def check_prepare(monkeypatch, argv: list[str], said: str | None) -> None:
    """Whether `prepare` ends a command of LeRobot's by these words, or lets it go on where None."""
    monkeypatch.setattr(sys, "argv", argv)
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)  # which `prepare` changes
    if said is None:
        prepare()
        return
    with pytest.raises(SystemExit, match=said):
        prepare()


@pytest.mark.parametrize(
    ("name", "damage", "said"),
    [
        ("model.safetensors", Path.unlink, "model.safetensors is missing; copy the whole folder again"),
        ("model.safetensors", cut, "model.safetensors is damaged .*not fully covered"),
        ("config.json", cut, "config.json is not valid JSON"),
        ("config.json", changed(type="pneutac_bd"), "config.json: field 'type': .*did you mean 'pneutac_bc'"),
        ("config.json", changed(newer=1), "config.json: The fields `newer` are not valid for .*train again"),
        ("config.json", changed(networks=0), "config.json: .*networks is 0; it must be 1 or more"),
    ],
)
def test_a_damaged_checkpoint_is_one_sentence_before_the_work(tmp_path, monkeypatch, name, damage, said):
    make_ready_policy().save_pretrained(tmp_path / "p")
    argv = ["lerobot-eval", f"--policy.path={tmp_path / 'p'}"]
    check_prepare(monkeypatch, argv, None)
    damage(tmp_path / "p" / name)
    check_prepare(monkeypatch, argv, f"^error: --policy.path: .*{said}")


SMALLER = {OBS_STATE: {"type": "STATE", "shape": [20]}, TACTILE: {"type": "VISUAL", "shape": [3, 48, 64]}}
ARM = {ACTION: {"type": "ACTION", "shape": [6]}}
SWITCH = {"instructions": ["Flip the toggle switch.", "flip the switch"]}


@pytest.mark.parametrize(
    ("argv", "fields", "said"),
    [
        (
            "lerobot-eval --env.type=pneutac",
            {"input_features": SMALLER},
            "are 240 x 320 px.*takes 64 x 48; give",
        ),
        (
            "lerobot-eval --env.type=pneutac",
            {"output_features": ARM},
            "gives 6 of action.* has 20 and 4: an arm",
        ),
        ("lerobot-rollout --robot.type=pneutac_sim", {"output_features": ARM}, "give --robot.twin and"),
        (
            "lerobot-eval --env.type=pneutac_standin --env.task=egg",
            SWITCH,
            "'Flip the toggle switch.' and --env",
        ),
        (
            "lerobot-rollout --robot.type=pneutac_sim --robot.task=egg",
            SWITCH,
            "--robot.task is 'egg'; give its",
        ),
        ("lerobot-rollout --robot.type=pneutac --task=egg", SWITCH, "--task is 'egg'; give its own task"),
        ("lerobot-train --env.type=pneutac --env.task=egg", SWITCH, None),
        ("lerobot-eval --env.type=pneutac --env.task=switch", SWITCH, None),
        ("lerobot-eval --env.type=pneutac --env.task=my_own_switch", SWITCH, None),
        ("lerobot-eval --env.type=pneutac --env.task=egg", {"instructions": ["do it"]}, None),
        ("lerobot-eval --env.type=pneutac --env.task=egg --policy.instructions=null", SWITCH, None),
        ("lerobot-eval --env.type=pneutac --env.task=egg", {}, None),
    ],
)
def test_a_policy_of_another_camera_body_or_task_is_refused_before_the_work(
    tmp_path, monkeypatch, argv, fields, said
):
    make_ready_policy().save_pretrained(tmp_path / "p")
    changed(**fields)(tmp_path / "p" / "config.json")
    argv = [*argv.split(), f"--policy.path={tmp_path / 'p'}"]
    check_prepare(monkeypatch, argv, said and f"error: --policy.path: .*{said}")


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["lerobot-eval", "--env.type=pneutac"], "at 30 Hz and the robot is controlled at 15 Hz; give --env"),
        (["lerobot-rollout", "--robot.type=pneutac_sim"], "controlled at 15 Hz; give --robot.station=FILE"),
        (["lerobot-train", "--steps=0"], "error: --steps is 0; it must be 1 or more"),
        (["lerobot-eval", "--eval.n_episodes=-2"], "error: --eval.n_episodes is -2; it must be 1 or more"),
        (["lerobot-record", "--dataset.single_task= "], "--dataset.single_task is blank; give the instruc"),
    ],
)
def test_what_lerobot_does_not_compare_is_refused_before_the_work(tmp_path, monkeypatch, argv, said):
    make_ready_policy().save_pretrained(tmp_path / "p")
    changed(control_hz=30)(tmp_path / "p" / "config.json")
    (tmp_path / "station.yaml").write_text("format: pneutac-station/1\ncontrol_hz: 30\n")
    argv = [*argv, f"--policy.path={tmp_path / 'p'}"]
    check_prepare(monkeypatch, argv, said)
    if "--env.type=pneutac" in argv:
        check_prepare(monkeypatch, [*argv, f"--env.station={tmp_path / 'station.yaml'}"], None)


REPLAY = f"lerobot-replay --dataset.root={Path(__file__).parents[2] / 'golden' / 'recordings' / 'demos'}"


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        ("lerobot-rollout --robot.type=pneutac_sim", "--fps is 30 Hz and .* at 15 Hz; give --fps=15, or"),
        ("lerobot-rollout --robot.type=pneutac --fps=20", "--fps is 20 Hz and the robot is controlled at 15"),
        ("lerobot-rollout --robot.type=pneutac_sim --fps=15", None),
        ("lerobot-rollout --robot.type=pneutac_sim --robot.station=station.yaml", None),
        ("lerobot-rollout --robot.type=so101_follower", None),
        (f"{REPLAY} --robot.type=pneutac_sim", None),
        (f"{REPLAY} --robot.type=pneutac_sim --robot.station=station.yaml", "has the rate 15 Hz .* at 30 Hz"),
    ],
)
def test_actions_at_another_rate_than_the_robots_are_refused_before_the_work(
    tmp_path, monkeypatch, argv, said
):
    (tmp_path / "station.yaml").write_text("format: pneutac-station/1\ncontrol_hz: 30\n")
    monkeypatch.chdir(tmp_path)
    check_prepare(monkeypatch, argv.split(), said and f"error: .*{said}")


def test_weights_that_are_no_numbers_are_named(tmp_path):
    policy = make_ready_policy()
    policy.encoder.rest_image.fill_(torch.nan)  # of a policy without data
    policy.save_pretrained(tmp_path)
    PneutacBCPolicy.from_pretrained(tmp_path)
    policy.mlp[2].bias.data[3] = torch.inf
    policy.save_pretrained(tmp_path)
    with pytest.raises(InputError, match=r"model.safetensors': mlp.2.bias contains NaN or infinity"):
        PneutacBCPolicy.from_pretrained(tmp_path)
