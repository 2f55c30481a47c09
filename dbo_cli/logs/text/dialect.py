"""How a text log is written: delimiter, decimal sign, header, units line and where the data begin.

Detected from the first lines; every part can be forced.  The bottom of the sample,
where junk lines are rare, decides delimiter, decimal sign and the number of columns;
then the first data row is looked for from the top, and the header above it.  In doubt a
line counts as data, so that it is refused aloud instead of dropped in silence.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from dbo_cli.errors import InputError, counted, decoded
from dbo_cli.logs.clock import Statement
from dbo_cli.logs.columns import split_header
from dbo_cli.logs.request import BLANKS, FILL_GAPS, ReadingOptions
from dbo_cli.logs.text.lines import (
    HeaderBlock,
    find_header_block,
    is_number,
    split_cells,
    value_of,
    writing_of,
)
from dbo_cli.logs.units import is_known_unit

_NAMES = {",": "comma", ";": "semicolon", "\t": "tab", BLANKS: "blanks", "|": "pipe"}
COMMENTS = "#%"
SAMPLE_LINES = 40  # enough rows to outvote junk lines
# Before a line of names or units: ``# columns:`` and ``# units:`` (JPK), ``#
# column_headers=`` (Qudi).
_LABEL = re.compile(
    r"(?:fancyNames|column_?(?:names|headers)|columns|channels|fields|names|(?P<unit>units?|einheiten?))"
    r"(?:\s*[:=]\s*|$)",
    re.IGNORECASE,
)
# 1.5 V, as Grafana formats its cells; V:1.5, as the Arduino's plotter reads it.
_NUMBER_WITH_UNIT = re.compile(
    r"(?<![\w.:-])(?:[-+]?\d+(?:[.,]\d+)? ?[^\W\d_]{1,4}\b|[^\W\d_]\w{0,20} ?[:=] ?[-+]?\d[\d.]*)"
)
_PLAIN_NUMBERS = "write them without units and labels; Grafana: without Formatted data"
_MOST_COLUMNS = 1 << 20  # a line of more delimiters is none of a log
# columns of a log whose names are lost; more, fewer lines, and names in front: it lies
_MOST_ACROSS = 64
# 1,234, to some 1234
_THOUSAND = re.compile(r"(?<![\d.,])[1-9]\d{0,2},\d{3}(?![\d,eEdD])")
_UNIT_OF_ONE = re.compile(
    r"(?P<name>\S.{0,60}?)[ _](?:unit|einheit)\s*[:=,;\t]\s*(?P<unit>\S{1,30})",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Dialect:
    """How a text log is written.

    ``first_line`` is the line number (from 1) of the first data row; ``headers`` and
    ``units`` are empty where the log has none, else ``width`` cells long.  ``numeric``
    are the columns (from 0) that hold numbers in most rows; ``writings`` is how each
    column is written (``Column.written``), where any holds time stamps;
    ``header_block`` is what stands again before each segment of the data; ``sparse``
    tells that every row leaves out a number that other rows have; ``labels`` are
    comments of names or units; ``remarks`` tells that a row may end in one cell of text
    more.

    ``clock`` is what the header states of the sample rate, ``start`` the time (s) of
    the first row, ``notes`` are for the user, and ``end_mark`` is what the program
    writes behind the last row. ``passed`` are the numbers and the texts of lines above
    the first row that belong neither to it nor to the header.
    """

    delimiter: str
    decimal: str
    comments: str
    width: int
    first_line: int
    headers: tuple[str, ...]
    units: tuple[str, ...]
    numeric: frozenset[int] = frozenset()
    writings: tuple[str, ...] = ()
    header_block: HeaderBlock | None = None
    sparse: bool = False
    labels: tuple[tuple[str, str], ...] = ()
    remarks: bool = False
    clock: Sequence[Statement] = ()
    start: float = 0.0
    notes: tuple[str, ...] = ()
    end_mark: bytes = b""
    passed: tuple[tuple[int, str], ...] = ()

    def is_comment(self, line: str) -> bool:
        """Return whether a line is empty or a comment."""
        return is_comment(line, self.comments)

    def cells(self, line: str) -> list[str]:
        """Split a line."""
        return split_cells(line, self.delimiter)

    def value(self, cell: str, written: str) -> float | None:
        """Read a cell of a column as a number or a time stamp (s), as it is written; None for neither."""
        return value_of(cell, self.decimal, written)

    def renamed(self, line: str) -> tuple[str, str] | None:
        """Return names above the data, and others that a comment gives the columns instead."""
        for label, names in labelled(line, self.comments) if self.labels else ():
            above = dict(self.labels).get(label, names)
            if above != names:
                return above, names
        return None

    def describe(self) -> str:
        """Describe in one line what was detected, for ``verbose``."""
        head = (
            "no header"
            if not self.headers
            else "a header" + (" and a units line" if self.units else "")
        )
        sign = "decimal comma" if self.decimal == "," else "decimal point"
        mark = _NAMES.get(self.delimiter, repr(self.delimiter))
        columns = counted(self.width, "column")
        return f"{columns} separated by {mark}, {sign}, {head}, data from line {self.first_line}"


def cause_of(cell: str) -> str:
    """Return what to do about a cell that many rows have instead of a number; empty where it is not known."""
    if not cell:
        return FILL_GAPS
    return _PLAIN_NUMBERS if _NUMBER_WITH_UNIT.fullmatch(cell) else ""


def is_comment(line: str, comments: str) -> bool:
    """Return whether a line is empty or a comment."""
    stripped = line.strip()
    return not stripped or stripped[0] in comments


def has_data(text: bytes, options: ReadingOptions) -> bool:
    """Return whether a line of numbers has arrived, so that a live log can begin."""
    forced = options.delimiter_character
    comments = COMMENTS if options.comment is None else options.comment
    marks = [forced] if forced else ["\t", ";", ",", " ", "|"]
    lines = [
        line
        for raw in text.split(b"\n")[-2::-1]
        if not is_comment(line := decoded(raw), comments)
    ]
    return any(
        all(is_number(cell, sign) for cell in split_cells(line, mark))
        for line in lines
        for mark in marks
        for sign in ".,"
    )


def detect(place: str, head: bytes, options: ReadingOptions) -> Dialect:
    """Find out how a log is written from its first lines.

    Raises
    ------
    InputError
        There is no line of numbers.
    """
    lines = [decoded(line.removesuffix(b"\r")) for line in head.split(b"\n")]
    lines[0] = lines[0].removeprefix("\ufeff")
    if not lines[-1]:
        lines.pop()
    comments = COMMENTS if options.comment is None else options.comment
    skip = options.skip_lines or 0
    candidates = [
        number
        for number in range(skip, len(lines))
        if not is_comment(lines[number], comments)
    ]
    if not any(line.strip() for line in lines):
        raise InputError(f"{place}: the file is empty")
    shapes = _shapes(lines, candidates, options)
    if not shapes:
        searches = (_NUMBER_WITH_UNIT.search(lines[n]) for n in reversed(candidates))
        match = next(filter(None, searches), None)
        if match is not None:
            raise InputError(
                f"{place}: no line holds plain numbers, but '{match[0]}' ({_PLAIN_NUMBERS})"
            )
        raise InputError(f"{place}: no data rows: no line holds numbers")
    best = max(shape.score for shape in shapes)
    tied = [shape for shape in shapes if shape.score >= best - 1e-12]
    # Single tabs read as blanks, too; a header with one name too few must not be taken
    # apart at its words.
    tabs = {shape.width for shape in tied if shape.delimiter == "\t"}
    tied = [
        shape for shape in tied if shape.delimiter != BLANKS or shape.width not in tabs
    ]
    layouts = [_layout(lines, candidates, shape, comments, options) for shape in tied]
    shape, layout = max(zip(tied, layouts, strict=True), key=lambda pair: pair[1].fits)
    decimal = shape.decimal
    either = len({tie.decimal for tie in tied if tie.delimiter == shape.delimiter}) > 1
    doubtful = either or (decimal == "." and shape.whole_numbers)
    if options.decimal is None and shape.delimiter != "," and doubtful:
        decimal = _late_decimal(place, lines[layout.first :], comments)
    data = [lines[number] for number in candidates if number >= layout.first]
    rows = [split_cells(line, shape.delimiter) for line in data[:SAMPLE_LINES]]
    last = [split_cells(line, shape.delimiter) for line in data[-SAMPLE_LINES:]]
    headers, units = _aligned(place, layout, shape.width, rows[:3])
    if headers and not any(units):
        units = _units_apart(lines[: layout.first], headers, shape, comments)
    if (
        not headers
        and 0 not in shape.numeric
        and shape.width > max(_MOST_ACROSS, len(data))
    ):
        raise InputError(
            f"{place}: the samples run along the lines, {shape.width - 1:,} in each: turn it round (pandas: "
            "read_csv(FILE, header=None, index_col=0).T)"
        )
    if not headers and options.header_lines is None:
        _ask_about_numbered_columns(place, rows)
    return Dialect(
        shape.delimiter, decimal, comments, shape.width, layout.first + 1, headers, units, shape.numeric,
        _writings(last, shape),
        find_header_block(lines, layout.first, shape.delimiter),
        _is_sparse(last, shape),
        tuple(label for line in lines[: layout.first] for label in labelled(line, comments)),
        passed=tuple((number + 1, lines[number].strip()) for number in layout.passed),
    )  # fmt: skip


def labelled(line: str, comments: str, units: bool = True) -> list[tuple[str, str]]:
    """Return the label of a comment that names columns (or units), with what follows it; else nothing."""
    body = line.strip().lstrip(comments).strip()
    label = _LABEL.match(body) if line.strip()[:1] in comments else None
    return (
        []
        if label is None or (label["unit"] and not units)
        else [(label[0], body[label.end() :])]
    )


def _is_sparse(rows: list[list[str]], shape: _Shape) -> bool:
    rows = [row[: shape.width] for row in rows]
    full = [
        [column for column, cell in enumerate(row) if is_number(cell, shape.decimal)]
        for row in rows
    ]
    if shape.delimiter == BLANKS or len(set(map(tuple, full))) < 2:
        return False
    partly = set().union(*full) - set(full[0]).intersection(*full[1:])
    return all(any(n < len(row) and not row[n] for n in partly) for row in rows)


def _ask_about_numbered_columns(place: str, rows: list[list[str]]) -> None:
    """Refuse a first row that counts the columns above rows of decimals: a table saved without names.

    Two numbers may be a sample written short (0,1), so they are asked about only where
    no other cell is.

    Raises
    ------
    InputError
        It may be a header or a sample.
    """
    first, *rest = rows
    written = first[1:] if not first[0] else first
    counted = [
        [str(number + start) for number in range(len(written))] for start in (0, 1)
    ]
    if written not in counted or len(written) < 2:
        return
    whole = [
        bool(re.fullmatch(r"[-+]?\d*", cell))
        for row in rest
        for cell in row[-len(written) :]
    ]
    if whole and (not any(whole) or (len(written) > 2 and not all(whole))):
        raise InputError(
            f"{place}: the first row, {','.join(written)}, counts the columns: are these names or a sample? "
            "(`header_lines` 1 or 0)"
        )


def _writings(rows: list[list[str]], shape: _Shape) -> tuple[str, ...]:
    """Find the columns of time stamps; empty where there are none."""
    texts = sorted(set(range(shape.width)) - shape.numeric)
    if not texts:
        return ()
    rows = [row for row in rows if len(row) >= shape.width]
    writings = {column: writing_of([row[column] for row in rows]) for column in texts}
    if not any(writings.values()):
        return ()
    return tuple(writings.get(column) or "numbers" for column in range(shape.width))


class _Shape(NamedTuple):
    """One reading of the sample: ``numeric`` are the columns that hold numbers in most of its rows."""

    delimiter: str
    decimal: str
    width: int
    numeric: frozenset[int]
    score: float
    whole_numbers: bool


def _shapes(
    lines: list[str], candidates: list[int], options: ReadingOptions
) -> list[_Shape]:
    """Read the last lines with every delimiter and decimal sign that may be meant."""
    delimiter, decimal = options.delimiter_character, options.decimal_sign
    sample = [lines[number] for number in candidates[-SAMPLE_LINES:]]
    shapes = []
    for sign in [decimal] if decimal else [".", ","]:
        for mark in [delimiter] if delimiter else ["\t", ";", ",", BLANKS, "|"]:
            absent = (
                delimiter is None
                and mark != BLANKS
                and not any(mark in line for line in sample)
            )
            alone = mark == "," and sign == "."  # one column without any delimiter
            if alone or not (absent or mark == sign):
                shapes.append(_shape(sample, mark, sign))
    return [shape for shape in shapes if shape is not None]


def _shape(sample: list[str], delimiter: str, decimal: str) -> _Shape | None:
    if any(line.count(delimiter) > _MOST_COLUMNS for line in sample):
        return None
    rows = [split_cells(line, delimiter) for line in sample]
    verdicts = [[is_number(cell, decimal) for cell in row] for row in rows]
    numbered = [number for number, verdict in enumerate(verdicts) if any(verdict)]
    if not numbered:
        return None
    shares = {
        number: sum(verdicts[number]) / sum(1 for cell in rows[number] if cell)
        for number in numbered
    }
    votes: dict[int, float] = defaultdict(float)
    # a key beside its value counts half of a full row of numbers
    for number in numbered:
        votes[len(rows[number])] += shares[number]
    width = max(votes, key=lambda count: (votes[count], count))
    usual = [number for number in numbered if len(rows[number]) == width]
    counts = [
        sum(verdicts[number][column] for number in usual) for column in range(width)
    ]
    numeric = frozenset(
        column for column, count in enumerate(counts) if 2 * count >= len(usual)
    )
    if not numeric:
        return None
    quality = sum(shares[number] for number in usual) / len(sample)
    whole = all(
        cell.lstrip("+-").isdigit() for number in usual for cell in rows[number] if cell
    )
    return _Shape(delimiter, decimal, width, numeric, quality, whole)


class _Layout(NamedTuple):
    """Where the data begin (index of the line) and the header rows above; ``fits`` ranks equal readings."""

    first: int
    names: list[str]
    units: list[str]
    fits: int
    passed: Sequence[int] = ()


def _layout(
    lines: list[str],
    candidates: list[int],
    shape: _Shape,
    comments: str,
    options: ReadingOptions,
) -> _Layout:
    if options.header_lines is not None or options.skip_lines is not None:
        return _forced_layout(lines, candidates, shape, options)
    rows = {}
    for good in candidates:
        cells = rows[good] = split_cells(lines[good], shape.delimiter)
        if len(cells) == shape.width and all(
            is_number(cells[n], shape.decimal) for n in shape.numeric
        ):
            break
    else:  # rows are there, but every one of them has a bad cell
        good = next(
            number for number in candidates if _some_numbers(rows[number], shape)
        )
    above = [number for number in candidates if number < good]
    numbered = [number for number in above if _some_numbers(rows[number], shape)]
    header = [number for number in above if _header_like(rows[number], shape)]
    if header:
        first = next((number for number in numbered if number > header[-1]), good)
        names, units = _names_and_units(rows, above, header)
        fits = 2 if len(_trimmed(names, shape.width)) == shape.width else 1
        below = [number for number in above if header[-1] < number < first]
        if (
            header[-1] - 1 in header
            and _has_units(rows[header[-1] - 1])
            and not (units or _has_units(names))
        ):
            below.insert(0, header[-1])  # the names may be a row without numbers
        return _Layout(
            first, names, units, fits, [n for n in below if not _is_ruled(rows[n])]
        )
    # What a blank line separates from the data are key-value lines of an instrument.
    blank = max(
        (number for number in range(good) if not lines[number].strip()), default=-1
    )
    full = (
        number
        for number in numbered
        if len(rows[number]) == shape.width and number > blank
    )
    first = next(full, good)
    names, units = _other_header(lines, first, shape, comments)
    empty = [
        n
        for n in above
        if n < first and len(rows[n]) == shape.width and not any(rows[n])
    ]
    return _Layout(first, names, units, 2 if names else 0, empty)


def _has_units(names: list[str]) -> bool:
    return any(split_header(name)[1] is not None for name in names)


def _is_ruled(cells: list[str]) -> bool:
    """Return whether a line only divides the header from the data, as one of dashes does."""
    return any(cells) and not re.search(r"\w", "".join(cells))


def _some_numbers(cells: list[str], shape: _Shape) -> bool:
    return any(
        column < len(cells) and is_number(cells[column], shape.decimal)
        for column in shape.numeric
    )


def _header_like(cells: list[str], shape: _Shape) -> bool:
    """No numbers where the data have them, and about as many cells (a trailing delimiter aside)."""
    if _some_numbers(cells, shape) or not any(re.search(r"\w", cell) for cell in cells):
        return False
    return abs(len(cells) - shape.width) <= 1 and len(cells) >= min(shape.width, 2)


def _names_and_units(
    rows: dict[int, list[str]], above: list[int], header: list[int]
) -> tuple[list[str], list[str]]:
    """Find the line of names from a line of units below it (and one of remarks below that)."""
    last = header[-1]
    joined = [
        n
        for n in (last, last - 1, last - 2)
        if all(k in header for k in range(n, last + 1))
    ]
    for number in joined:
        units = _units_in(rows[number])
        if units:
            place = above.index(number)
            named = (
                rows[n]
                for n in above[:place][::-1]
                if re.search(r"\w", "".join(rows[n]))
            )
            over = next(named, [])  # not a line of dashes
            if over and abs(len(over) - len(units)) <= 1 and not _units_in(over):
                return over, units
            return (rows[last], units) if number < last else (rows[number], [])
    return rows[last], []


def _units_in(cells: list[str]) -> list[str]:
    """Return the cells of a line of units, a label in front (``Units: s``) aside; empty for any other."""
    label = _LABEL.match(cells[0]) if cells else None
    cells = (
        [cells[0][label.end() :], *cells[1:]]
        if label is not None and label["unit"]
        else cells
    )
    filled = [cell.strip("[](){}<> ") for cell in cells if cell.strip("[](){}<> -")]
    return cells if filled and all(is_known_unit(cell) for cell in filled) else []


def _units_apart(
    above: list[str], names: tuple[str, ...], shape: _Shape, comments: str
) -> tuple[str, ...]:
    """Find units that stand apart from the names: in a comment, or one a line (``Voltage unit: mV``)."""
    stated = {}
    for line in above:
        body = line.strip().lstrip(comments).strip()
        label = _LABEL.match(body)
        match = _UNIT_OF_ONE.fullmatch(body)
        if match is not None and is_known_unit(match["unit"].strip("[]()")):
            stated[match["name"].lower()] = match["unit"]
        elif (label is not None and label["unit"]) or line.strip()[:1] in comments:
            cells = _fitting_cells(
                body[label.end() :] if label is not None else body, shape
            )
            if cells is not None and _units_in(cells):
                return tuple(cells)
    units = tuple(stated.get(name.lower(), "") for name in names)
    return units if any(units) else ()


def _other_header(
    lines: list[str], first: int, shape: _Shape, comments: str
) -> tuple[list[str], list[str]]:
    """Look for a header in the comment lines, or the differently separated line, right above the data."""
    labels = (
        cells_of_line
        for text in lines[:first][::-1]
        for cells_of_line in labelled(text, comments, units=False)
    )
    for _, names in labels:  # JPK's and Qudi's
        cells = _fitting_cells(names.strip("'").replace(";;", ";"), shape)
        if cells is not None:
            return cells, []
    headers: list[list[str]] = []
    for number in range(first - 1, max(-1, first - 4), -1):
        text = lines[number].strip()
        body = text.lstrip(comments).strip() if text and text[0] in comments else text
        if body.isdigit() and body != text and number == first - 1:
            continue  # QCoDeS counts its rows there
        cells = _fitting_cells(body, shape) if body else None
        if cells is None:
            break
        headers.append(cells)
    if len(headers) > 1 and _units_in(headers[0]) and not _units_in(headers[1]):
        return headers[1], headers[0]
    return (headers[0] if headers else []), []


def _fitting_cells(text: str, shape: _Shape) -> list[str] | None:
    """Split a header line in the way that gives as many cells as the data have columns."""
    ways = [split_cells(text, mark) for mark in ("\t", ";", ",", "|") if mark in text]
    ways.append(split_cells(text, shape.delimiter))
    certain = shape.delimiter != BLANKS and shape.delimiter in text
    if certain:
        ways = ways[-1:]
    ways.append([cell.strip() for cell in re.split(r"\s{2,}|\t+", text)])
    # else, taken apart at blanks, a header with one name too few would shift all the
    # others
    if not certain:
        ways.append(
            [
                cell.strip()
                for cell in re.findall(r"[^\s(\[]+\s*(?:[(\[][^)\]]{0,60}[)\]])?", text)
            ]
        )
        ways.append(text.split())
    fitting = (cells for cells in ways if len(cells) == shape.width and all(cells))
    return next(
        (
            cells
            for cells in fitting
            if not any(is_number(cell, shape.decimal) for cell in cells)
        ),
        None,
    )


def _forced_layout(
    lines: list[str], candidates: list[int], shape: _Shape, options: ReadingOptions
) -> _Layout:
    count = options.header_lines
    if count is None:
        rows = [
            split_cells(lines[number], shape.delimiter) for number in candidates[:2]
        ]
        count = sum(1 for row in rows if not _some_numbers(row, shape))
        count = min(count, 2 if len(rows) > 1 and _units_in(rows[1]) else 1)
    if len(candidates) <= count:
        return _Layout(len(lines), [], [], 0)
    above = [lines[number] for number in candidates[:count]]
    rows = [
        _fitting_cells(line, shape) or split_cells(line, shape.delimiter)
        for line in above
    ]
    return _Layout(
        candidates[count], rows[0] if count else [], rows[1] if count > 1 else [], 1
    )


def _trimmed(cells: list[str], width: int) -> list[str]:
    """Take off what a trailing delimiter adds, and the header of a comment column that the rows leave out."""
    while len(cells) > width and (not cells[-1] or cells[-1].lower() == "comment"):
        cells = cells[:-1]
    return cells


def _aligned(
    place: str, layout: _Layout, width: int, rows: list[list[str]]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Bring the header to the width of the rows, or refuse one that cannot be meant for them."""
    names = _trimmed(layout.names, width)
    if names and len(names) == width - 1:
        if rows and not rows[0][-1]:
            names = [*names, ""]  # the rows end with a delimiter
        elif rows and [row[0] for row in rows] == [
            str(number + 1) for number in range(len(rows))
        ]:
            names = ["", *names]  # numbered rows, their column without a name
    if names and len(names) != width:
        raise InputError(
            f"{place}:{layout.first + 1}: {width} cells where the header names {len(names)} columns "
            "(check the delimiter, or skip the lines above the data with `skip_lines`)"
        )
    units = _trimmed(layout.units, width)
    units = [*units, *[""] * (width - len(units))][:width] if units else []
    return tuple(name.strip() for name in names), tuple(units)


def _late_decimal(place: str, lines: list[str], comments: str) -> str:
    """Decide the decimal sign where the sample held whole numbers, or 1,234 which may be one, only.

    Raises
    ------
    InputError
        Every comma stands before three digits, as one between thousands does, too.
    """
    rows = [line for line in lines if not is_comment(line, comments)]
    commas = [line for line in rows if re.search(r"\d,\d", line)]
    if not commas or any(re.search(r"\d\.\d|\d,\d{3},\d", line) for line in rows):
        return "."
    if any(re.search(r"\d,\d", _THOUSAND.sub("", line)) for line in commas):
        return ","
    match = _THOUSAND.search(commas[0])
    assert match is not None
    raise InputError(
        f"{place}: '{match[0]}' may be {match[0].replace(',', '')} or {match[0].replace(',', '.')} "
        "(`decimal` point or comma)"
    )
