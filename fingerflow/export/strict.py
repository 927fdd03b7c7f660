"""Types of settings without conversion: "700" and true are not numbers, 0.5 is not an integer."""

from typing import Annotated

from pydantic import AfterValidator, Strict


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError(f"{value} is even; the middle pixel needs an odd side, such as {value + 1}")
    return value


StrictInt = Annotated[int, Strict()]
StrictNumber = Annotated[float, Strict()]  # an integer is accepted
StrictBool = Annotated[bool, Strict()]
Odd = Annotated[StrictInt, AfterValidator(_odd)]
