"""The line-by-line translation of Structured Text, against values by hand."""

import pytest
from tests.export.native import st_stepper

BLOCK = """\
(* A counter that
   wraps. *)
FUNCTION_BLOCK counter
VAR_INPUT
    x : LREAL; (* [V] what is added *)
END_VAR
VAR_OUTPUT
    y : LREAL;
END_VAR
VAR
    total : LREAL := 0.5;
    kept : ARRAY[0..2] OF LREAL := [3(1.0)];
END_VAR
VAR CONSTANT
    weight : ARRAY[0..1] OF LREAL := [2.0, 1.0E-1];
END_VAR
VAR_TEMP
    k : DINT;
END_VAR

    IF NOT (x <> 0.0) OR x = 7.0 AND TRUE THEN
        total := 0.0;
    ELSE
        FOR k := 0 TO 2 DO
            total := total + x * weight[0];
        END_FOR;
    END_IF;
    kept[TRUNC(total) MOD 3] := MAX(total, 3.0);
    y := total + kept[0] + EXPT(2.0, 3.0) - DINT_TO_LREAL(BOOL_TO_DINT(x < 0.0));
END_FUNCTION_BLOCK
"""


def test_a_block_by_hand():
    step = st_stepper(BLOCK, ["y"])
    assert step(1.0) == [6.5 + 6.5 + 8.0]  # 0.5 + 3·2, into kept[0]
    assert step(0.0) == [0.0 + 3.0 + 8.0]
    assert step(7.0) == [0.0 + 3.0 + 8.0]
    assert step(-0.25) == [-1.5 + 3.0 + 8.0 - 1.0]  # the remainder of −1 is written to kept[2]


def test_what_is_not_of_the_subset_is_refused():
    with pytest.raises(ValueError, match="not of the subset: WHILE"):
        st_stepper(BLOCK.replace("kept[TRUNC", "WHILE x < 1.0 DO\n    kept[TRUNC"), ["y"])
