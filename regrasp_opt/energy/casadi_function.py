"""CasADi functions that bring their own first and second derivatives into every graph that they are put in.

CasADi differentiates a larger expression node by node. For a call of a function made here it takes what the function
brings along instead of differentiating its inside:

- `by_jacobian`: the Jacobian ``jac_NAME`` and its Jacobian ``jac_jac_NAME``, for a few outputs. Both are kept when the
  function is saved.
- `by_adjoint`: for many outputs the adjoint ``adj1_NAME``, which gradients need, the adjoint's Jacobian
  ``jac_adj1_NAME``, which Hessians need, and ``jac_NAME``. CasADi does not save adjoints: after loading, it
  differentiates the inside where it needs one.

Higher derivatives are CasADi's own. Derivatives do not take the function's value as an argument (it enters with an
empty sparsity pattern), so that none of them costs an evaluation of the function.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

Blocks = Mapping[str, Any]
"""A derivative by input names; a block that is left out is zero, and CasADi is told that it is."""

_CALLED: dict[str, Any] = {"never_inline": True}
_ONLY_JACOBIAN: dict[str, Any] = {**_CALLED, "jac_penalty": 0, "enable_forward": False, "enable_reverse": False}


def by_jacobian(
    name: str, inputs: Blocks, output: str, value: Any, jacobian: Blocks, second: Mapping[tuple[str, str], Any]
) -> Any:
    """Return the `casadi.Function` of `inputs`, symbols by name, to `value` (M numbers) with two derivatives.

    `jacobian` has (M, numel of the input) by input name, `second`, by two input names, the derivative of the stacked
    columns of the first one's Jacobian in the second one.
    """
    rows, empty = _jacobian_blocks(inputs, output, value, jacobian), _no_numbers(value)
    columns = {**inputs, f"out_{output}": empty}
    blocks = {
        f"jac_{row}_{column}": second.get((first, column), ca.MX(block.numel(), symbol.numel()))
        for (row, block), first in zip(rows.items(), inputs, strict=True)
        for column, symbol in columns.items()
    }
    symbols = [*columns.values()]
    unused = {f"out_{row}": _no_numbers(block) for row, block in rows.items()}
    second_derivative = ca.Function(
        f"jac_jac_{name}", [*symbols, *unused.values()], [*blocks.values()], [*columns, *unused], [*blocks], _CALLED
    )
    options = {**_ONLY_JACOBIAN, "custom_jacobian": second_derivative}
    derivative = ca.Function(f"jac_{name}", symbols, [*rows.values()], [*columns], [*rows], options)
    return _function(name, inputs, output, value, jacobian, {**_ONLY_JACOBIAN, "custom_jacobian": derivative})


def by_adjoint(
    name: str, inputs: Blocks, output: str, value: Any, jacobian: Blocks, seed: Any, adjoint: Blocks, second: Blocks
) -> Any:
    """Return the `casadi.Function` of `inputs` to `value` (M numbers) with its adjoint and its Jacobian.

    `inputs` and `jacobian` are as in `by_jacobian`; `seed`, a symbol of the shape of `value`, is the adjoint's last
    argument. `adjoint` has ``jacobian.T @ seed`` in the input's shape by input name, `second` the derivative of that in
    the input itself at a fixed seed; mixed ones are taken to be zero.
    """
    empty, seeded = _no_numbers(value), f"adj_{output}"
    symbols, names = [*inputs.values(), empty], [*inputs, f"out_{output}"]
    rows = _jacobian_blocks(inputs, output, value, jacobian)
    derivative = ca.Function(f"jac_{name}", symbols, [*rows.values()], names, [*rows], _CALLED)

    sides = {f"adj_{key}": adjoint.get(key, ca.MX(*symbol.shape)) for key, symbol in inputs.items()}
    blocks = {}
    for (side, expression), first in zip(sides.items(), inputs, strict=True):
        for column, symbol in zip([*names, seeded], [*symbols, seed], strict=True):
            block = second.get(first) if column == first else None
            if column == seeded and first in jacobian:
                block = jacobian[first].T
            blocks[f"jac_{side}_{column}"] = ca.MX(expression.numel(), symbol.numel()) if block is None else block
    unused = {f"out_{side}": _no_numbers(expression) for side, expression in sides.items()}
    arguments = [*symbols, seed, *unused.values()], [*blocks.values()], [*names, seeded, *unused], [*blocks]
    second_derivative = ca.Function(f"jac_adj1_{name}", *arguments, _CALLED)
    options = {**_ONLY_JACOBIAN, "custom_jacobian": second_derivative}
    back = ca.Function(f"adj1_{name}", [*symbols, seed], [*sides.values()], [*names, seeded], [*sides], options)
    # One direction back goes through the adjoint; more of them at once, and all forward ones, through the Jacobian.
    both = {"custom_jacobian": derivative, "cache": {f"adj1_{name}": back}, "jac_penalty": 1.5 / max(value.numel(), 1)}
    return _function(name, inputs, output, value, jacobian, {**_CALLED, "enable_forward": False, **both})


def _function(name: str, inputs: Blocks, output: str, value: Any, jacobian: Blocks, options: Mapping[str, Any]) -> Any:
    differentiated = [key in jacobian for key in inputs]
    return ca.Function(
        name, [*inputs.values()], [value], [*inputs], [output], {**options, "is_diff_in": differentiated}
    )


def _jacobian_blocks(inputs: Blocks, output: str, value: Any, jacobian: Blocks) -> dict[str, Any]:
    size = value.numel()
    return {f"jac_{output}_{key}": jacobian.get(key, ca.MX(size, symbol.numel())) for key, symbol in inputs.items()}


def _no_numbers(expression: Any) -> Any:
    """Return a symbol of the shape of `expression` whose pattern is empty."""
    return ca.MX.sym("none", ca.Sparsity(*expression.shape))
