import pytest
import torch

from avatarrex.ops.encoding import channels, encode, encode_reference


def test_closed_form():
    x = torch.tensor([[0.0, 0.5, -1.0]])
    expected = [0.0, 0.5, -1.0]
    for octave in (1, 2, 4):
        expected += [float(torch.sin(octave * v)) for v in x[0]] + [float(torch.cos(octave * v)) for v in x[0]]
    torch.testing.assert_close(encode(x, 3)[0], torch.tensor(expected), atol=1e-6, rtol=0)


@pytest.mark.parametrize("tracked", [False, True])
@pytest.mark.parametrize(("points", "octaves"), [(0, 6), (1, 1), (257, 6), (5, 0), (64, 4)])
def test_recurrence_follows_the_equation(tracked, points, octaves):
    x = (3 * torch.randn(points, 3, generator=torch.Generator().manual_seed(points))).requires_grad_(tracked)
    fast = encode(x, octaves)
    assert fast.shape == (points, channels(octaves)) == (points, 3 + 6 * octaves)
    torch.testing.assert_close(fast, encode_reference(x, octaves), atol=5e-6, rtol=0)


def test_gradients_in_double():
    x = torch.randn(4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).clamp(-1.9, 1.9)
    x.requires_grad_()
    assert torch.autograd.gradcheck(lambda v: encode(v, 6), x)
    assert torch.autograd.gradgradcheck(lambda v: encode(v, 3), x)


def test_far_points_are_clamped():
    far = torch.tensor([[1e30, -1e30, 5.0]])
    torch.testing.assert_close(encode(far, 6), encode(torch.tensor([[2.0, -2.0, 2.0]]), 6), atol=0, rtol=0)
