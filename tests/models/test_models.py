"""What the built-in models promise beyond the contract that test_conformance.py holds them to."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

from candata.errors import UnknownNameError, UsageError
from candata.models import Sizes, model, model_names

NAMES = ["contact_diffusion", "diffusion_unet", "mlp", "unet"]
DIFFUSIONS = NAMES[:2]
FULL = Sizes(history=8, horizon=16, joints=15, actuators=15, fingertips=5, points=512)


def parameters(module: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def gradients(net: torch.nn.Module, loss: torch.Tensor) -> dict[str, float]:
    """Largest gradient of each parameter that has one."""
    net.zero_grad()
    loss.backward()
    return {name: float(p.grad.abs().max()) for name, p in net.named_parameters() if p.grad is not None}


def test_a_near_name_is_proposed():
    assert set(model_names()) >= set(NAMES)
    with pytest.raises(UnknownNameError, match="did you mean 'mlp'"):
        model("mpl")


@pytest.mark.parametrize("name", NAMES)
def test_every_preset_says_what_it_reads(name):
    found = model(name)
    assert list(found.presets) == ["small", "base", "paper"]
    assert not found.presets["paper"].planned_actions
    assert found.presets["base"].planned_actions
    assert getattr(found.presets["paper"], "target", "epsilon") == "epsilon"
    assert ("contact" in found.reads(found.presets["base"])) == (name == "contact_diffusion")
    asked = found.parse({"fingertip_contact": True})
    assert "fingertip_contact" in found.reads(asked)
    assert "fingertip_contact" not in found.reads(found.presets["paper"])


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ({"kernel": 4}, "kernel must be odd"),
        ({"widths": [12, 30]}, "groups 8 must divide"),
        ({"widths": []}, "widths"),
        ({"point_widths": [0]}, "at least 1"),
        ({"sampling_steps": 200}, "must not exceed train_steps"),
        ({"target": "v"}, "target"),
        ({"no_such": 1}, "no_such"),
        ({"contact_grad": "half"}, "contact_grad"),
    ],
)
def test_a_wrong_configuration_names_its_field(values, field):
    with pytest.raises(UsageError, match=field):
        model("contact_diffusion").parse(values)


@pytest.mark.parametrize(("preset", "millions"), [("base", 24.0), ("paper", 75.8)])
def test_parameter_counts(preset, millions, normaliser):
    found = model("contact_diffusion")
    count = parameters(found.build(found.presets[preset], FULL, normaliser(FULL)))
    # The specification's figures are of other encoders and do not say the size of q and a: within 3 %.
    assert count / 1e6 == pytest.approx(millions, rel=0.03)


@pytest.mark.parametrize("name", NAMES)
def test_only_the_contact_model_forecasts_contact(name, tiny, batch, generator):
    found = tiny(name).forecast(batch(5), 3, 4, generator(0))
    assert (found.contact is not None) == (name == "contact_diffusion")


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("mlp", {}),
        ("diffusion_unet", {"target": "epsilon"}),
        ("diffusion_unet", {"sampler": "ddpm"}),
        ("contact_diffusion", {}),
        ("contact_diffusion", {"contact_input": "mixed"}),
    ],
)
def test_the_generator_decides_everything(name, fields, tiny, batch, awake, generator):
    net, windows = awake(tiny(name, **fields)), batch(4)
    losses = [float(net.losses(windows, generator(seed))["loss"].detach()) for seed in (1, 1, 2)]
    drawn = [net.forecast(windows, 3, 4, generator(seed)).increments for seed in (1, 1, 2)]
    assert losses[0] == losses[1]
    assert torch.equal(drawn[0], drawn[1])
    if name != "mlp":
        assert losses[0] != losses[2]
        assert not torch.equal(drawn[0], drawn[2])
        assert not torch.equal(drawn[0][0], drawn[0][1])


def test_samples_of_the_mlp_are_equal(tiny, batch, generator):
    found = tiny("mlp").forecast(batch(2), 4, 1, generator(0)).increments
    assert torch.equal(found[0], found[3])


@pytest.mark.parametrize("name", NAMES)
def test_a_padded_future_has_no_influence_on_the_loss(name, tiny, batch, awake, generator):
    fields = {"contact_input": "true"} if name == "contact_diffusion" else {}
    net, windows = awake(tiny(name, **fields)), batch(4)
    whole = net.losses(windows, generator(0))
    windows["future_pad"][:, 5:] = True
    before = net.losses(windows, generator(0))
    # Windows repeat the last row there; NaN is the hardest thing to ignore.
    windows["future/object_pose"][:, 5:] = torch.nan
    windows["planned/action"][:, 6:] = torch.nan
    windows["future/contact"][:, 5:] = ~windows["future/contact"][:, 5:]
    after = net.losses(windows, generator(0))
    assert before.keys() == after.keys()
    for term in before:
        assert torch.equal(before[term], after[term]), term
        assert not torch.equal(before[term], whole[term]), term
    assert all(size < float("inf") for size in gradients(net, after["loss"]).values())


@pytest.mark.parametrize("name", NAMES)
def test_a_batch_of_nothing_but_pads_costs_nothing(name, tiny, batch, generator):
    windows = batch(2)
    windows["future_pad"][:] = True
    found = tiny(name).losses(windows, generator(0))
    assert all(value.detach() == 0 for value in found.values())


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("planned", [False, True])
def test_planned_actions_are_read_only_when_asked(name, planned, tiny, batch, awake, generator):
    net, windows = awake(tiny(name, planned_actions=planned)), batch(3)
    before = net.forecast(windows, 1, 3, generator(0))
    after = net.forecast(windows | {"planned/action": windows["planned/action"] + 1}, 1, 3, generator(0))
    assert torch.equal(before.increments, after.increments) != planned
    if name == "contact_diffusion":
        assert torch.equal(before.contact, after.contact) != planned


@pytest.mark.parametrize("contact_grad", ["full", "stop"])
def test_stop_keeps_the_diffusion_loss_from_the_contact_head(contact_grad, tiny, batch, awake, generator):
    net = awake(tiny("contact_diffusion", contact_grad=contact_grad))
    found = gradients(net, net.losses(batch(4), generator(0))["diffusion"])
    head = [size for name, size in found.items() if name.startswith("contact_head")]
    assert any(head) == (contact_grad == "full")
    assert all(size > 0 for name, size in found.items() if name.startswith(("contact_feature", "encoder.temporal")))


def test_the_whole_loss_reaches_every_parameter(tiny, batch, awake, generator):
    for name in NAMES:
        net = awake(tiny(name, fingertip_contact=True))
        found = gradients(net, net.losses(batch(4), generator(0))["loss"])
        assert found.keys() == {name for name, _ in net.named_parameters()}
        assert all(size > 0 for size in found.values())


@pytest.mark.parametrize(("given", "reads"), [("predicted", False), ("true", True), ("mixed", True)])
def test_the_denoiser_is_trained_on_the_contact_asked_for(given, reads, tiny, batch, awake, generator):
    net, windows = awake(tiny("contact_diffusion", contact_input=given)), batch(6)
    before = net.losses(windows, generator(0))["diffusion"]
    after = net.losses(windows | {"future/contact": ~windows["future/contact"]}, generator(0))["diffusion"]
    assert torch.equal(before, after) != reads
    forecasts = [net.forecast(w, 1, 2, generator(0)).increments for w in (windows, windows | {"future/contact": None})]
    assert torch.equal(*forecasts), "a forecast must not read the future"


def test_lambda_weighs_the_diffusion_loss(tiny, batch, generator):
    found = tiny("contact_diffusion", diffusion_weight=3.0).losses(batch(3), generator(0))
    torch.testing.assert_close(found["loss"], found["contact"] + 3 * found["diffusion"])


def test_a_network_of_the_noise_overfits_one_small_batch(tiny, batch, generator):
    net, windows = tiny("diffusion_unet", widths=[16], target="epsilon"), batch(4)
    optimiser = torch.optim.AdamW(net.parameters(), lr=1e-2, weight_decay=0.0)
    history = []
    for _ in range(80):
        # The same noise each time: fresh noise as the target would be no batch that could be learnt by heart.
        losses = net.losses(windows, generator(0))
        optimiser.zero_grad()
        losses["loss"].backward()
        optimiser.step()
        history.append(float(losses["loss"].detach()))
    assert sum(history[-10:]) < sum(history[:10]) / 10, (history[:3], history[-3:])


@pytest.mark.parametrize("name", DIFFUSIONS)
def test_an_impossible_number_of_sampling_steps_is_refused(name, tiny, batch, generator):
    with pytest.raises(UsageError, match="1 to 100"):
        tiny(name).forecast(batch(1), 1, 101, generator(0))


def test_without_torch_the_room_opens_and_a_model_says_what_to_install():
    code = """
import sys
sys.modules["torch"] = None
from candata.errors import MissingExtraError
import candata.models
assert "mlp" in candata.models.model_names()
for use in (lambda: candata.models.model("mlp"), lambda: candata.models.integrate):
    try:
        use()
    except MissingExtraError as error:
        print(error)
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.count("torch is not installed") == 2
    assert 'pip install "candata[train]"' in found.stdout


@pytest.mark.parametrize("name", ["mlp", "contact_diffusion"])
def test_members_take_turns(name, tiny, batch, awake, generator):
    windows, three = batch(4), awake(tiny(name, members=3))
    drawn = three.forecast(windows, 5, 2, generator(0)).increments
    assert drawn.shape[0] == 5
    assert [bool((drawn[0] - drawn[k]).abs().max() > 1e-6) for k in (1, 2)] == [True, True]
    single = [net.forecast(windows, 2, 2, generator(0)).increments for net in three.nets]
    assert torch.equal(drawn[0], single[0][0])
    loss = three.losses(windows, generator(0))["loss"]
    loss.backward()
    assert all(p.grad is not None for p in three.parameters())


def test_one_member_is_the_net_itself(tiny):
    assert type(tiny("mlp", members=1)) is type(tiny("mlp"))
