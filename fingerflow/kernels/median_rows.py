"""Execution of a median program row by row of tiles: order of the steps, and storage of the planes.

A program of `median_network` works on whole planes. To stay in a processor's cache the compiled kernels do one row of
tiles at a time and keep, of every plane, only the rows that are still read. A plane's *lead* is how many rows of tiles
ahead of the row of medians it is computed, so that whatever it is read for lies behind it. Both the networks that are
compiled (`kernels/generate_median.py`) and those that are sent to the kernels as a table (`median_table`) go by this.
"""

import functools

from fingerflow.kernels.median_network import MedianProgram, Step, median_program

COMPILED_SIZES = (3, 5, 7, 9, 11)


class RowOrder:
    """Steps of a program in the order in which they run for a row of tiles: largest lead first."""

    def __init__(self, program: MedianProgram) -> None:
        self.program = program
        self.inputs = range(program.tile[0] * program.tile[1])
        self.leads = self._leads()
        # Whatever a step reads has the same lead or a larger one: the order stays valid.
        self.steps = sorted(program.steps, key=lambda step: -self.leads[step.result])
        # Of planes that a later row reads: how many rows are kept.
        self.kept_rows: dict[int, int] = {}
        for step in self.steps:
            for plane, age, _ in self.operands(step):
                if age and plane not in self.inputs:
                    self.kept_rows[plane] = max(self.kept_rows.get(plane, 0), age + 1)
        self.warm_up = max(self.leads.values())
        self.lines = program.tile[0] * (1 + max(self.leads[plane] for plane in self.inputs))

    def operands(self, step: Step) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
        """Return both operands of a step: plane, age in rows of tiles, and shift to the right in columns of tiles."""
        lead = self.leads[step.result]
        return (
            (step.left, self.leads[step.left] - lead, 0),
            (step.right, self.leads[step.right] - lead - step.rows, step.columns),
        )

    def line(self, plane: int, age: int) -> int:
        """Return the buffer index of an input plane as it was `age` rows of tiles earlier."""
        return (self.leads[plane] - age) * len(self.inputs) + plane

    def _leads(self) -> dict[int, int]:
        """Return the lead of every plane: how many rows of tiles ahead of the medians it is computed."""
        assert all((plane.rows, plane.columns) == (0, 0) for plane in self.program.outputs)
        leads = {output.plane: 0 for output in self.program.outputs}
        for step in reversed(self.program.steps):
            lead = leads[step.result]
            leads[step.left] = max(leads.get(step.left, 0), lead)
            leads[step.right] = max(leads.get(step.right, 0), lead + step.rows)
        return leads


@functools.cache
def median_table(size: int) -> tuple[int, ...]:
    """Return the median program for a window size as integers below 2^16, which `kernels/median.cpp` executes.

    A row of tiles has a list of planes: the lines of the frame, the kept rows of each kept plane from the youngest to
    the oldest, the scratch slots. A step is (kind, minimum, maximum, left, right, columns) with places in that list;
    kind 1 has a minimum, 2 a maximum, 3 both.
    """
    order = RowOrder(median_program(size))
    rows, columns = order.program.tile
    scratch = _Slots(order)
    kept: dict[int, int] = {}
    count = order.lines * columns
    for plane, depth in order.kept_rows.items():
        kept[plane] = count
        count += depth

    def place(plane: int, age: int) -> int:
        if plane in order.inputs:
            return order.line(plane, age)
        return kept[plane] + age if plane in kept else count + scratch.slots[plane]

    steps: list[list[int]] = []
    ahead = 0
    previous: Step | None = None
    for number, step in enumerate(order.steps):
        left, right = order.operands(step)
        if previous is not None and _same_operands(order, previous, step) and steps[-1][0] != 3:
            kind, minimum, maximum, *rest = steps.pop()
        else:
            kind, minimum, maximum = 0, 0, 0
            rest = [place(*left[:2]), place(*right[:2]), right[2]]
        scratch.take(number, step.result)
        if step.operation == "minimum":
            kind, minimum = kind | 1, place(step.result, 0)
        else:
            kind, maximum = kind | 2, place(step.result, 0)
        steps.append([kind, minimum, maximum, *rest])
        if order.leads[step.result]:
            ahead = len(steps)
        previous = step
    outputs = [scratch.slots[output.plane] for output in order.program.outputs]
    head = [rows, columns, order.program.reach[1], len(kept), scratch.count, order.warm_up, order.lines]
    head += [ahead, len(steps)]
    table = (*head, *outputs, *order.kept_rows.values(), *(number for step in steps for number in step))
    assert max(table) < 1 << 16
    return table


def _same_operands(order: RowOrder, first: Step, second: Step) -> bool:
    return first[2:6] == second[2:6] and order.leads[first.result] == order.leads[second.result]


class _Slots:
    """Assignment of scratch memory to planes that only their own row reads; a slot is reused after the last read."""

    def __init__(self, order: RowOrder) -> None:
        self.order = order
        self.slots: dict[int, int] = {}
        self.count = 0
        self._free: list[int] = []
        last = {plane: n for n, step in enumerate(order.steps) for plane in (step.left, step.right)}
        kept = {*order.inputs, *order.kept_rows, *(output.plane for output in order.program.outputs)}
        self._released: dict[int, list[int]] = {}
        for plane, step in last.items():
            if plane not in kept:
                self._released.setdefault(step, []).append(plane)

    def take(self, number: int, plane: int) -> None:
        """Take a slot for the result of a step, then free the slots of planes that no later step reads.

        In this order a step never writes what it reads.
        """
        if plane not in self.order.kept_rows:
            if not self._free:
                self._free.append(self.count)
                self.count += 1
            self.slots[plane] = self._free.pop()
        self._free += [self.slots[released] for released in self._released.get(number, [])]
