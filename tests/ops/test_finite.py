"""What carries NaN or Inf is refused; numbers whose sum overflows are not."""

import pytest
import torch

from avatarrex.errors import InputError
from avatarrex.ops.finite import require_finite


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
def test_one_bad_number_is_refused(dtype: torch.dtype, bad: float) -> None:
    values = torch.ones(7, 1001, dtype=dtype)
    values[3, 500] = bad
    with pytest.raises(InputError, match="here: there: expected finite numbers, found NaN or Inf"):
        require_finite("here", fine=torch.ones(3), there=values)


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
def test_numbers_whose_sum_overflows_are_numbers(dtype: torch.dtype) -> None:
    require_finite("here", there=torch.full((5000,), torch.finfo(dtype).max, dtype=dtype))


def test_opposite_infinities_do_not_cancel() -> None:
    with pytest.raises(InputError):
        require_finite("here", there=torch.tensor([torch.inf, -torch.inf, 1.0]))
