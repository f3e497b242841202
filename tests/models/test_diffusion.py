"""The schedule and the samplers, against diffusers and against closed forms."""

from __future__ import annotations

import math

import pytest
import torch

diffusers = pytest.importorskip("diffusers")

from candata.errors import UsageError  # noqa: E402
from candata.models._diffusion import Process, cosine_alpha_bars, trailing_times  # noqa: E402

STEPS = 100
#: diffusers multiplies a hundred float32 factors where we multiply float64 ones.
FLOAT32 = {"rtol": 1e-4, "atol": 1e-5}
ORACLE = {"ddim": diffusers.DDIMScheduler, "ddpm": diffusers.DDPMScheduler}
KINDS = [(sampler, target) for sampler in ("ddim", "ddpm") for target in ("x0", "epsilon")]


def process(sampler: str, target: str) -> Process:
    return Process(tuple(cosine_alpha_bars(STEPS)), target, sampler)


def oracle(sampler: str, target: str, steps: int):
    found = ORACLE[sampler](
        num_train_timesteps=STEPS,
        beta_schedule="squaredcos_cap_v2",
        prediction_type="sample" if target == "x0" else "epsilon",
        clip_sample=target == "epsilon",
        timestep_spacing="trailing",
    )
    found.set_timesteps(steps)
    return found


def their_step(scheduler, output, time, x, generator):
    extra = {"generator": generator}
    return scheduler.step(output, time, x, **extra).prev_sample


def numbers(seed: int) -> torch.Tensor:
    return torch.randn(3, 6, 8, generator=torch.Generator().manual_seed(seed))


def network(x: torch.Tensor, time: int) -> torch.Tensor:
    """Any smooth function of x and the time."""
    return torch.tanh(1.3 * x.roll(1, -1) - 0.01 * time) * 0.8


def test_alpha_bars_are_those_of_diffusers():
    theirs = oracle("ddpm", "x0", STEPS).alphas_cumprod
    ours = torch.tensor(cosine_alpha_bars(STEPS))
    torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=0)
    assert ours[-1] == pytest.approx(2.4e-7, rel=0.02)  # two digits are given in the specification


@pytest.mark.parametrize("steps", [1, 2, 4, 5, 10, 20, 50, 100])
def test_times_are_those_of_diffusers(steps):
    assert trailing_times(STEPS, steps) == oracle("ddim", "x0", steps).timesteps.tolist()


@pytest.mark.parametrize("steps", [0, -1, 101])
def test_an_impossible_number_of_steps_is_refused(steps):
    with pytest.raises(UsageError, match="1 to 100"):
        trailing_times(STEPS, steps)


@pytest.mark.parametrize(("sampler", "target"), KINDS)
@pytest.mark.parametrize("index", [0, 4, 9])
def test_one_step_is_that_of_diffusers(sampler, target, index):
    ours, theirs = process(sampler, target), oracle(sampler, target, 10)
    x, output, generator = numbers(1), 0.5 * numbers(2), torch.Generator().manual_seed(3)
    wanted = their_step(theirs, output, theirs.timesteps[index], x, generator)
    noise = torch.randn(x.shape, generator=torch.Generator().manual_seed(3)) if index < 9 else None
    torch.testing.assert_close(ours.advance(x, output, ours.walk(10)[index], noise), wanted, **FLOAT32)


@pytest.mark.parametrize(("sampler", "target"), KINDS)
@pytest.mark.parametrize("steps", [10, 100])
def test_a_whole_trajectory_is_that_of_diffusers(sampler, target, steps):
    ours, theirs = process(sampler, target), oracle(sampler, target, steps)
    times, x, generator = ours.times(steps), numbers(4), torch.Generator().manual_seed(5)
    for time in theirs.timesteps:
        x = their_step(theirs, network(x, int(time)), time, x, generator)
    found = ours.sample(lambda y, i: network(y, times[i]), numbers(4), steps, torch.Generator().manual_seed(5))
    # Errors of single steps add up over the trajectory.
    torch.testing.assert_close(found, x, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(("sampler", "target"), KINDS)
@pytest.mark.parametrize("steps", [1, 3, 7, 10])
def test_a_network_that_knows_the_truth_reaches_it(sampler, target, steps):
    truth = numbers(6).clamp(-1, 1)
    ours = process(sampler, target)
    walk = ours.walk(steps)

    def knows(x: torch.Tensor, i: int) -> torch.Tensor:
        if target == "x0":
            return truth
        level = walk[i].signal_before
        return (x - math.sqrt(level) * truth) / math.sqrt(1 - level)

    found = ours.sample(knows, numbers(7), steps, torch.Generator().manual_seed(0))
    # In epsilon one float32 rounding of x at alpha-bar 2.4e-7 is worth 1e-4, and clipping hides half of it.
    torch.testing.assert_close(found, truth, rtol=0, atol=2e-3 if target == "epsilon" else 1e-6)


def test_ddim_adds_no_noise_and_ddpm_does():
    for sampler in ("ddim", "ddpm"):
        ours = process(sampler, "x0")
        a, b = (
            ours.sample(lambda x, i: 0.5 * x, numbers(8), 10, torch.Generator().manual_seed(seed)) for seed in (1, 2)
        )
        assert torch.equal(a, b) == (sampler == "ddim")
