"""How a text log is written, found on its first lines as a person would find it.

The last of these lines decide the delimiter, the decimal sign and the columns; the
first line that is written as they are is the first row; names and units stand right
above it. What is not clear is refused with the option that says it.
"""

import re
from collections.abc import Iterator, Sequence

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.cells import (
    DATE,
    MISSING,
    Layout,
    is_number,
    is_stamp,
    split_cells,
    stamp_format,
)
from dbo_cli.logs.names import are_names, read_header
from dbo_cli.logs.settings import is_setting
from dbo_cli.logs.table import LONGEST_CELL, TOO_LONG, Reading

_PLAINLY = "write plain numbers, with points where commas delimit"
COMMENTS = "#%"
"""A line that begins with one of these is a comment."""

_SAMPLE = 40  # rows from which the dialect is found
_JUDGED = 400  # rows in which the decimal sign must be clear
_BLANKS = 0.9
_FADING = 0.7  # a line counts so much less than the one below it
_DELIMITERS = {
    "comma": ",", "semicolon": ";", "tab": "\t", "blanks": " ", "space": " ", "pipe": "|",
}  # fmt: skip
_NAMES = {mark: word for word, mark in _DELIMITERS.items()}
_DECIMALS = {"point": ".", "comma": ",", ".": ".", ",": ","}
_TWO_READINGS = re.compile(r"\s*[-+]?\d+,\d+\s*", re.ASCII)
_DIGITS = frozenset("0123456789")
_DELIMITED = re.compile(r"\d[;\t|]|[;\t|]\d")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}", re.ASCII)
ERROR = r"#[A-Z][A-Z/0]*[!?]?[;,\t|]"  # how a row begins that a spreadsheet could not compute


def is_no_row(line: str) -> bool:
    """Return whether a line is blank or a comment, and no row that begins with ``#N/A``."""
    plain = line.strip()
    is_comment = not plain or plain[0] in COMMENTS or plain == "EOF"  # TwinCAT's end
    return is_comment and not re.match(ERROR, plain)


def find_layout(name: str, lines: Sequence[str], reading: Reading) -> Layout:
    """Find out how a log is written; what the user says is not looked for.

    Parameters
    ----------
    name
        The file, for messages.
    lines
        The first lines, without their ends.
    reading
        ``delimiter``, ``decimal`` and ``skip_lines`` as the user gave them.

    Raises
    ------
    InputError
        There are no rows of numbers, or it is not clear how they are written.
    """
    skipped = reading.skip_lines or 0
    rows = [n for n in range(skipped, len(lines)) if not is_no_row(lines[n])]
    while rows and not lines[rows[-1]].strip("\t ;,|"):
        rows.pop()
    if all(_DIGITS.isdisjoint(lines[n]) for n in rows):
        where = f" below `skip_lines` {skipped}" if skipped else ": is the log empty?"
        raise InputError(f"{name}: no line holds a number{where}")
    sample = [lines[n] for n in rows[-_SAMPLE:]]
    layout = _best_layout(sample, reading)
    if layout is None:
        raise InputError(
            f"{name}: no line holds numbers only: try `delimiter`, `decimal` or `skip_lines`, or {_PLAINLY}"
        )
    table = [split_cells(lines[n], layout.delimiter) for n in rows[-_JUDGED:]]
    layout.first = _first_row(layout, lines, rows)
    layout.first_line = lines[layout.first]
    above, below = lines[skipped : layout.first], lines[layout.first :]
    read_header(above, below, layout)
    unclear = _two_readings(layout, sample, table, reading)
    if unclear is not None:
        text, how = unclear
        raise InputError(f"{name}: '{text}' may be read in two ways: type {how}")
    above_rows = [n for n in rows if n < layout.first]
    for n, skip in _unclear_starts(layout, lines, above_rows):
        if n != layout.first or reading.skip_lines is None:
            text = " ".join(lines[n].split())[:40]
            raise InputError(
                f"{name}:{n + 1}: '{text}': row or names? Type `skip_lines` {skip}, `delimiter` or `decimal`"
                f", or {_PLAINLY}"
            )
    return layout


def _two_readings(
    layout: Layout,
    sample: Sequence[str],
    table: Sequence[Sequence[str]],
    reading: Reading,
) -> tuple[str, str] | None:
    """Return a text that may be read in two ways, and what the user can type; None where all is clear.

    ``500;1`` holds another delimiter; commas may all stand between thousands; ``0,5`` may
    be two columns where nothing is called by a name.
    """
    if reading.delimiter is None:
        for kind, text in layout.kinds:
            found = _DELIMITED.search(text) if kind == "text" else None
            if found is not None:
                marks = found[0].strip("0123456789"), layout.delimiter
                return text, " or ".join(
                    f"`delimiter` {_NAMES[mark]}" for mark in marks
                )
    if reading.decimal is None and layout.decimal == ",":
        cells = [cell for row in table for cell in row]
        commas = [cell for cell in cells if "," in cell and is_number(cell, ",")]
        if commas and all(map(_THOUSANDS.fullmatch, commas)):
            how = "`decimal` comma, or write numbers without marks between thousands"
            return commas[0], how
    is_told = reading.delimiter or reading.decimal or any(layout.names)
    is_short = max(map(len, sample)) <= LONGEST_CELL
    if not is_told and is_short and all(map(_TWO_READINGS.fullmatch, sample)):
        how = "`delimiter` comma for two columns, or `decimal` comma for one"
        return sample[-1].strip(), how
    return None


def _unclear_starts(
    layout: Layout, lines: Sequence[str], above: Sequence[int]
) -> Iterator[tuple[int, int]]:
    """Return lines that make it unclear where the rows begin, and how many lines to skip for that.

    Numbers of another width above the rows; names for another number of columns; a first
    row 0, 1, 2 where nothing is called by a name; names below the first rows.
    """
    first, width = layout.first, layout.width
    for n in reversed(above):
        cells = [cell for cell in split_cells(lines[n], layout.delimiter) if cell]
        if cells and all(is_number(cell, layout.decimal) for cell in cells):
            yield n, n + 1
    for n in above[-1:]:
        if not layout.is_headed and _may_be_names(lines[n:first], layout):
            yield n, first
    cells = [cell for cell in split_cells(lines[first], layout.delimiter) if cell]
    counted = [[str(start + k) for k in range(len(cells))] for start in (0, 1)]
    has_decimals = any(layout.decimal in line for line in lines[first + 1 : first + 3])
    is_counted = len(cells) > 1 and cells in counted and has_decimals
    if is_counted and not any(layout.names):
        yield first, first + 1
    for n in range(first + 1, min(first + _SAMPLE, len(lines))):
        cells = split_cells(lines[n], layout.delimiter)
        if len(cells) == width > 1 and are_names(cells) and cells != layout.names:
            yield n, n


def _may_be_names(lines: Sequence[str], layout: Layout) -> bool:
    """Return whether the first of the lines above the rows may be names for other columns, or a torn row."""
    cells = split_cells(lines[0].rstrip(f" {layout.delimiter}"), layout.delimiter)
    is_last = not any(line.strip() for line in lines[1:])
    if len(cells) < 2 or is_setting(cells[0]) or not is_last:
        return False
    if any(is_number(cell) for cell in cells):
        return len(lines) == 1
    return len(cells) != layout.width


def delimiter_of(text: str) -> str:
    """Read the option ``delimiter``.

    Raises
    ------
    UsageError
        It is neither a known name nor a single character.
    """
    mark = _DELIMITERS.get(text, "\t" if text == "\\t" else text)
    if len(mark) != 1 or not mark.isascii() or mark.isalnum() or mark in '"\n\r+-.':
        raise UsageError(
            f"`delimiter` {text}: give a single character or one of {', '.join(_DELIMITERS)}"
        )
    return mark


def _best_layout(sample: Sequence[str], reading: Reading) -> Layout | None:
    """Return the layout under which most of the cells are numbers in rows of one width."""
    marks = list(dict.fromkeys(_DELIMITERS.values()))
    if reading.delimiter is not None:
        marks = [delimiter_of(reading.delimiter)]
    signs = [".", ","]
    if reading.decimal is not None:
        if reading.decimal not in _DECIMALS:
            raise UsageError(f"`decimal` {reading.decimal}: give point or comma")
        signs = [_DECIMALS[reading.decimal]]
    quoted = any('"' in line for line in sample)
    best, layout = (0.0, False, False), None
    for mark in marks:
        for sign in signs:
            if mark == sign and not quoted:
                continue
            share, candidate = _judged(sample, mark, sign)
            if mark == " ":
                share *= _BLANKS  # stand around other delimiters, too
            score = (round(share, 9), candidate.width > 1, mark != " ")
            if share > 0.0 and score > best:
                best, layout = score, candidate
    return layout


def _judged(sample: Sequence[str], mark: str, sign: str) -> tuple[float, Layout]:
    """Split lines with a delimiter: the share of cells that are numbers, and the layout.

    The table is at the end: each line counts less than the one below it.
    """
    layout = Layout(mark, sign)
    table = [split_cells(line, mark) for line in sample]
    weights = [_FADING**k for k in range(len(table))][::-1]
    shares: dict[int, float] = {}
    for cells, weight in zip(table, weights, strict=True):
        nonempty = [cell for cell in cells if cell.lower() not in MISSING]
        numbers = [cell for cell in nonempty if is_number(cell, sign)]
        if numbers:
            share = weight * len(numbers) / len(nonempty)
            shares[len(cells)] = shares.get(len(cells), 0.0) + share
    if not shares:
        return 0.0, layout
    width = max(shares, key=lambda width: (shares[width], width))
    rows = [k for k in range(len(table)) if len(table[k]) == width]
    for n in range(width):
        cells = [table[k][n] for k in rows]
        weighted = [(table[k][n], weights[k]) for k in rows]
        if n == 0 and _is_mostly_one_kind(cells, sign):  # the last rows may have labels
            weighted = [(cell, 1.0) for cell in cells]
        layout.kinds.append(_kind_of(weighted, sign))
    share = shares[width] / sum(weights)
    return (share if layout.numeric else 0.0), layout


def _kind_of(cells: Sequence[tuple[str, float]], sign: str) -> tuple[str, str]:
    """Return what most cells of a column, each with its weight, hold; see ``Layout.kinds``."""
    total = sum(weight for _, weight in cells)
    numbers = sum(weight for cell, weight in cells if is_number(cell, sign))
    if 2.0 * numbers >= total:
        return "number", ""
    if 2.0 * sum(weight for cell, weight in cells if not cell) > total:
        return "empty", ""
    form = stamp_format(cells)
    if form is not None:
        return "stamp", form
    texts = [cell for cell, _ in cells if cell and not is_number(cell, sign)]
    dates = [text for text in texts if DATE.search(text)]
    if 2 * len(dates) > len(texts):
        texts = dates
    return "text", texts[-1][: len(TOO_LONG)]


def _is_mostly_one_kind(cells: Sequence[str], sign: str) -> bool:
    """Return whether more than half of the cells are numbers, or stamps of one format."""
    numbers = sum(is_number(cell, sign) for cell in cells)
    is_stamped = stamp_format([(cell, 1.0) for cell in cells]) is not None
    return 2 * numbers > len(cells) or is_stamped


def _is_row(line: str, layout: Layout) -> bool:
    """Return whether a line is written as the rows are."""
    cells = split_cells(line, layout.delimiter)
    if len(cells) != layout.width:
        return False
    if layout.kinds[0][0] != "number" and is_setting(cells[0]):
        return False
    for cell, (kind, form) in zip(cells, layout.kinds, strict=True):
        if kind == "number" and not is_number(cell, layout.decimal):
            return False
        if kind == "stamp" and not is_stamp(cell, form):
            return False
        if kind == "empty" and cell:
            return False
    return True


def _first_row(layout: Layout, lines: Sequence[str], rows: Sequence[int]) -> int:
    """Find the first line that is written as the last ones are.

    Lines right above it with numbers in their places are rows, too: they are to be
    refused, not passed over.
    """
    fitting = (k for k, n in enumerate(rows) if _is_row(lines[n], layout))
    index = next(fitting, None)
    if index is None:
        partly = (k for k, n in enumerate(rows) if layout.partly_fits(lines[n]))
        index = next(partly, 0)
    while index > 0 and layout.partly_fits(lines[rows[index - 1]]):
        index -= 1
    if lines[rows[min(index + 1, len(rows) - 1)]].rstrip().endswith(":"):
        index = min(index + 2, len(rows) - 1)  # figures above "data:" are no row
    return rows[index]
