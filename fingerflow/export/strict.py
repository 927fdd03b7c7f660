"""Types of settings that take nothing for something else: "700" and true are no numbers, 0.5 is no whole one."""

from typing import Annotated

from pydantic import AfterValidator, Strict


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError(f"{value} is even; the middle pixel needs an odd side, such as {value + 1}")
    return value


StrictInt = Annotated[int, Strict()]
StrictNumber = Annotated[float, Strict()]  # a whole number is one
StrictBool = Annotated[bool, Strict()]
Odd = Annotated[StrictInt, AfterValidator(_odd)]
