"""Texts with a few changes, as a hand, an editor or an attacker makes them."""

import random

TOKENS = (
    ".nan -1 1e400 null [] {} true [1,2] &a *a !!python/object:os.system 2020-01-01 # 0 : ? - é " + "[" * 90
).split()
CELLS = (
    "",
    "nan",
    "inf",
    "-1",
    "1e400",
    "9" * 400,
    "x",
    "é",
    "1;2",
    '"',
    "=1+1",
    "\x1b[2J",
    "../../etc/passwd",
    "0",
)
JSON = (
    "null",
    "[]",
    "{}",
    "true",
    "-1",
    "1e400",
    "NaN",
    '""',
    '"' + "x" * 500 + '"',
    "[[[[1]]]]",
    '{"a": {"b": 1}}',
    "9" * 400,
)


def mutated_lines(lines: list[str], rng: random.Random, tokens: tuple[str, ...] = tuple(TOKENS)) -> str:
    """A text of `name: value` lines after one to three changes."""
    lines = list(lines)
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(len(lines))
        line = lines[at]
        cut = rng.randrange(len(line) + 1)
        lines[at] = rng.choice(
            (
                f"{line.split(':')[0]}: {rng.choice(tokens)}",
                line[:cut] + rng.choice(tokens) + line[cut:],
                line[:cut] + line[cut + 1 :],
                f"{line}\n{rng.choice(lines)}",
                "  " * rng.randrange(4) + line.strip(),
            )
        )
    return "\n".join(lines)


def mutated_json(lines: list[str], rng: random.Random) -> str:
    """A JSON text with one field a line, after one or two changes, most of them still JSON."""
    lines = list(lines)
    for _ in range(rng.randint(1, 2)):
        at = rng.randrange(1, len(lines) - 1)
        name, found, value = lines[at].partition(":")
        comma = "," if value.rstrip().endswith(",") else ""
        if found and rng.random() < 0.8:
            lines[at] = f"{name}: {rng.choice(JSON)}{comma}"
        else:
            lines[at] = mutated_lines([lines[at]], rng)
    return "\n".join(lines)


def mutated_csv(lines: list[str], rng: random.Random) -> str:
    """A table after one to three changes of cells, columns or rows."""
    rows = [line.split(",") for line in lines]
    for _ in range(rng.randint(1, 3)):
        kind, row, column = rng.randrange(7), rng.randrange(len(rows)), rng.randrange(len(rows[0]))
        if kind == 0:
            rows[row][column % len(rows[row])] = rng.choice(CELLS)
        elif kind == 1:
            for r in rows[1:]:
                r[column % len(r)] = rng.choice(CELLS[:9]) if rng.random() < 0.5 else r[column % len(r)]
        elif kind == 2:
            rows[0][column] = rng.choice([*rows[0], *CELLS, "temperature_c", "force_x_n", "image", "mask_a"])
        elif kind == 3:
            rows = [[c for i, c in enumerate(r) if i != column] or [""] for r in rows]
        elif kind == 4:
            rows[row] = rows[row][: column + 1]
        elif kind == 5:
            rows.insert(row, list(rng.choice(rows)))
        else:
            rows = rows[: rng.randrange(1, len(rows) + 1)]
    return "\n".join(",".join(r) for r in rows) + "\n"
