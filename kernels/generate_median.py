"""Generator of the C++ of the median networks, from the programs of `fingerflow/kernels/median_network.py`.

A program works on planes, one value a tile. The C++ here goes down the frame one row of tiles at a time and keeps, of
every plane, only the rows that are still read. Three numbers place a step:

- its *lead*: how many rows of tiles ahead of the row of medians it runs, so that what it is read for lies behind it;
- its *pass*: within one row of tiles the steps run in a few passes from left to right; a value read from a tile further
  right comes from an earlier pass, everything else stays in a register;
- its *slot*: where a value that another pass or a later row reads is kept.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fingerflow.kernels.median_network import MedianProgram, Step, median_program
from fingerflow.kernels.median_rows import COMPILED_SIZES, RowOrder

DIFFERENCES = 0.4  # share of operations that go by a difference
GENERATES = "median_networks.h"


class Placement(RowOrder):
    """Order of rows with the passes and the scratch slots of the planes."""

    def __init__(self, program: MedianProgram) -> None:
        super().__init__(program)
        self.passes = self._passes()
        self.spans = self._spans()
        # Kept planes have a slot in each of as many rings as there are kept rows.
        self.ring_slots = {plane: slot for slot, plane in enumerate(sorted(self.kept_rows))}
        self.ages = max(self.kept_rows.values(), default=1)
        self.scratch, self.scratch_count = self._scratch()
        # Above the first row of medians only what runs ahead is needed.
        self.passes_ahead = 1 + max((self.passes[plane] for plane, lead in self.leads.items() if lead), default=-1)

    def _passes(self) -> dict[int, int]:
        passes = dict.fromkeys(self.inputs, 0)
        for step in self.steps:
            assert step.columns >= 0
            passes[step.result] = max(
                passes[plane] + (columns > 0 and plane not in self.inputs) if age == 0 else 0
                for plane, age, columns in self.operands(step)
            )
        return passes

    def _spans(self) -> dict[int, int]:
        """Return how many tiles beyond the last one of a row each plane is computed for."""
        spans = dict.fromkeys(self.leads, 0)
        for step in reversed(self.program.steps):
            for plane, _, columns in self.operands(step):
                spans[plane] = max(spans[plane], spans[step.result] + columns)
        return spans

    def _scratch(self) -> tuple[dict[int, int], int]:
        """Return the slots of planes that a later pass over the same row reads, and their number."""
        last_pass = {output.plane: 1 + max(self.passes.values()) for output in self.program.outputs}
        for step in self.steps:
            for plane, _, _ in self.operands(step):
                later = self.passes[step.result]
                if later > self.passes[plane] and plane not in (*self.ring_slots, *self.inputs):
                    last_pass[plane] = max(last_pass.get(plane, 0), later)
        free: list[int] = []
        busy: list[tuple[int, int]] = []  # (last pass, slot)
        slots: dict[int, int] = {}
        count = 0
        for plane in sorted(last_pass, key=lambda plane: (self.passes[plane], plane)):
            free += sorted(slot for last, slot in busy if last < self.passes[plane])
            busy = [(last, slot) for last, slot in busy if last >= self.passes[plane]]
            slot = slots[plane] = free.pop() if free else count
            count = max(count, slot + 1)
            busy.append((last_pass[plane], slot))
        return slots, count


def network_source(program: MedianProgram) -> str:
    """Return a struct with the constants of the program and one static function that runs one row of tiles."""
    place = Placement(program)
    (rows, columns), right = program.tile, program.reach[1]
    passes = 1 + max(place.passes.values())
    constants = {
        "kSize": program.size,
        "kTileRows": rows,
        "kTileColumns": columns,
        "kReachRight": right,
        "kAges": place.ages,
        "kRingSlots": len(place.ring_slots),
        "kScratchSlots": place.scratch_count,
        "kWarmUp": place.warm_up,
        "kLines": place.lines,
    }
    lines = [f"template <class Pixel>\nstruct MedianNetwork{program.size} {{"]
    lines += [f"    static constexpr int {name} = {value};" for name, value in constants.items()]
    lines.append("    static constexpr long kSlots = kAges * kRingSlots + kScratchSlots;")
    lines.append("    static constexpr long kStride = kSlotBytes / static_cast<long>(sizeof(Pixel));")
    slots = ", ".join(str(place.scratch[output.plane]) for output in program.outputs)
    lines.append(f"    static constexpr std::uint16_t kOutputSlots[] = {{{slots}}};")
    arguments = (
        "const Pixel* const* lines, Pixel* const* ring, Pixel* FINGERFLOW_RESTRICT scratch, long tiles, bool ahead"
    )
    lines.append(f"    static void run({arguments}) {{")
    lines += ["        using L = Lanes<Pixel>;", "        using Value = typename L::Value;"]
    for number in range(passes):
        if number == place.passes_ahead:
            lines.append("        if (ahead) return;")
        lines += _pass_source(place, number)
    return "\n".join([*lines, "    }", "};", ""])


def _pass_source(place: Placement, number: int) -> list[str]:
    steps = [step for step in place.steps if place.passes[step.result] == number]
    span = max(place.spans[step.result] for step in steps)
    loaded: set[str] = set()
    body: list[str] = []
    ages: set[int] = set()
    input_lines: set[int] = set()

    def value(plane: int, age: int, columns: int) -> str:
        if plane not in place.inputs and (age, columns) == (0, 0) and place.passes[plane] == number:
            return f"v{plane}"  # in a register
        name = f"a{plane}_{age}_{columns}"
        if name not in loaded:
            if plane in place.inputs:
                line = place.line(plane, age)
                input_lines.add(line)
                where = f"i{line} + x + {columns}"
            elif plane in place.ring_slots:
                ages.add(age)
                where = f"r{age} + {place.ring_slots[plane]} * kStride + x + {columns}"
            else:
                where = f"scratch + {place.scratch[plane]} * kStride + x + {columns}"
            body.append(f"            const Value {name} = L::load({where});")
            loaded.add(name)
        return name

    by_difference = _by_difference(steps)
    for step in steps:
        first, second = (value(*operand) for operand in place.operands(step))
        function = "lesser" if step.operation == "minimum" else "greater"
        arguments = f"{first}, {second}"
        if step.result in by_difference:
            name = f"d{by_difference[step.result]}"
            if step.result == by_difference[step.result]:
                body.append(f"            const Value {name} = L::excess({arguments});")
            arguments += f", {name}"
        body.append(f"            const Value v{step.result} = L::{function}({arguments});")
        for slots, array in ((place.ring_slots, "r0"), (place.scratch, "scratch")):
            if step.result in slots:
                ages |= {0} if array == "r0" else set()
                where = f"{array} + {slots[step.result]} * kStride + x"
                body.append(f"            L::store({where}, v{step.result});")
    pointers = [f"            Pixel* const FINGERFLOW_RESTRICT r{age} = ring[{age}];" for age in sorted(ages)]
    pointers += [f"            const Pixel* const FINGERFLOW_RESTRICT i{n} = lines[{n}];" for n in sorted(input_lines)]
    head = f"        {{  // pass {number}"
    loop = [f"            const long end = whole_lanes<Pixel>(tiles + {span});", "            FINGERFLOW_INDEPENDENT"]
    return [
        head,
        *pointers,
        *loop,
        "            for (long x = 0; x < end; x += L::kStep) {",
        *("    " + b for b in body),
        "            }",
        "        }",
    ]


def _by_difference(steps: list[Step]) -> dict[int, int]:
    """Return the steps whose minimum and maximum come from one difference, each with the first step of its pair.

    With p of n operations in such pairs of two, one port takes n - p and both together n + p / 2: equal for p = 0.4 n.
    """
    pairs: dict[tuple[int, ...], list[int]] = {}
    for step in steps:
        pairs.setdefault((step.left, step.right, step.rows, step.columns), []).append(step.result)
    both = [pair for pair in pairs.values() if len(pair) == 2]
    wanted = round(DIFFERENCES * len(steps) / 2)
    chosen = [
        pair for place, pair in enumerate(both) if (place + 1) * wanted // len(both) > place * wanted // len(both)
    ]
    return {result: first for first, second in chosen for result in (first, second)}


def source() -> str:
    """Return the networks of all compiled sizes, and a macro that names these sizes."""
    parts = ["// Written by kernels/generate_median.py.", "#pragma once", ""]
    parts += [network_source(median_program(size)) for size in COMPILED_SIZES]
    parts += [f"#define FINGERFLOW_MEDIAN_SIZES(use) {' '.join(f'use({size})' for size in COMPILED_SIZES)}", ""]
    return "\n".join(parts)
