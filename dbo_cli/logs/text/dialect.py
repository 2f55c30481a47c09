"""How a text log is written: delimiter, decimal sign, header, units line and where the data begin.

Detected from the first lines; every part can be forced.  The bottom of the sample,
where junk lines are rare, decides delimiter, decimal sign and the number of columns;
then the first data row is looked for from the top, and the header above it.  In doubt a
line counts as data, so that it is refused aloud instead of dropped in silence.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NoReturn

from dbo_cli.errors import InputError, counted, decoded
from dbo_cli.logs.clock import Statement
from dbo_cli.logs.columns import parse_column, split_header
from dbo_cli.logs.request import BLANKS, FILL_GAPS, ReadingOptions
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.text.lines import (
    RepeatedHeader,
    find_repeated_header,
    is_number,
    split_cells,
    value_of,
    writing_of,
)
from dbo_cli.logs.units import is_known_unit

_DELIMITERS = ("\t", ";", ",", BLANKS, "|")
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
    ``repeated_header`` is what stands again before each segment of the data; ``sparse``
    tells that every row leaves out a number that other rows have; ``labels`` are
    comments of names or units; ``remarks`` tells that a row may end in one cell of text
    more.

    ``clock`` is what the header states of the sample rate, ``start`` the time (s) of
    the first row, ``notes`` are for the user, and ``end_mark`` is what the program
    writes behind the last row. ``passed`` are the numbers and the texts of lines above
    the first row that belong neither to it nor to the header.

    ``score`` is the share of numbers in the lines that it was detected from, and
    ``fits`` ranks dialects of equal score: 2 where a header names every column, 1 where
    there is another one.
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
    repeated_header: RepeatedHeader | None = None
    sparse: bool = False
    labels: tuple[tuple[str, str], ...] = ()
    remarks: bool = False
    clock: Sequence[Statement] = ()
    start: float = 0.0
    notes: tuple[str, ...] = ()
    end_mark: bytes = b""
    passed: tuple[tuple[int, str], ...] = ()
    score: float = 0.0
    fits: int = 0

    def column(self, index: int) -> Column:
        """Return a column (from 0); one without a name that holds no numbers is called text."""
        written = self.written(index)
        name = ""
        if self.headers:
            name = self.headers[index]
        elif written == "numbers" and index not in self.numeric:
            name = "(text)"
        unit = self.units[index] if self.units else ""
        return replace(parse_column(name, index + 1, unit), written=written)

    def written(self, index: int) -> str:
        """Return how a column (from 0) is written (``Column.written``)."""
        return self.writings[index] if self.writings else "numbers"

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
        if not self.labels:
            return None
        for label, names in labelled(line, self.comments):
            above = dict(self.labels).get(label, names)
            if above != names:
                return above, names
        return None

    def describe(self) -> str:
        """Describe in one line what was detected, for ``verbose``."""
        head = "no header"
        if self.headers:
            head = "a header"
            if self.units:
                head = "a header and a units line"
        sign = "decimal comma" if self.decimal == "," else "decimal point"
        mark = _NAMES.get(self.delimiter, repr(self.delimiter))
        columns = counted(self.width, "column")
        return f"{columns} separated by {mark}, {sign}, {head}, data from line {self.first_line}"


def cause_of(cell: str) -> str:
    """Return what to do about a cell that many rows have instead of a number; empty where it is not known."""
    if not cell:
        return FILL_GAPS
    if _NUMBER_WITH_UNIT.fullmatch(cell):
        return _PLAIN_NUMBERS
    return ""


def is_comment(line: str, comments: str) -> bool:
    """Return whether a line is empty or a comment."""
    stripped = line.strip()
    return not stripped or stripped[0] in comments


def has_data(text: bytes, options: ReadingOptions) -> bool:
    """Return whether a line of numbers has arrived, so that a live log can begin."""
    comments = _comments(options)
    marks = _delimiters(options)
    for raw in text.split(b"\n")[-2::-1]:
        line = decoded(raw)
        if not is_comment(line, comments) and _is_row(line, marks):
            return True
    return False


def _is_row(line: str, marks: Sequence[str]) -> bool:
    """Return whether a line holds nothing but numbers, separated by one of the marks."""
    for mark in marks:
        cells = split_cells(line, mark)
        for sign in ".,":
            if all(is_number(cell, sign) for cell in cells):
                return True
    return False


def _comments(options: ReadingOptions) -> str:
    """Return the characters that begin comments."""
    return COMMENTS if options.comment is None else options.comment


def _delimiters(options: ReadingOptions) -> Sequence[str]:
    """Return the delimiters that may be meant."""
    if options.delimiter_character is not None:
        return [options.delimiter_character]
    return _DELIMITERS


def detect(place: str, head: bytes, options: ReadingOptions) -> Dialect:
    """Find out how a log is written from its first lines.

    Raises
    ------
    InputError
        There is no line of numbers.
    """
    lines = _lines_of(head)
    if not any(line.strip() for line in lines):
        raise InputError(f"{place}: the file is empty")
    comments = _comments(options)
    candidates = _candidates(lines, comments, options.skip_lines or 0)
    sample = [lines[number] for number in candidates[-SAMPLE_LINES:]]
    readings = _readings(sample, comments, options)
    if not readings:
        _refuse_no_numbers(place, [lines[number] for number in candidates])
    tied = _best_readings(readings)
    with_headers = [
        _with_header(reading, lines, candidates, options) for reading in tied
    ]
    dialect = max(with_headers, key=lambda reading: reading.fits)
    first = dialect.first_line - 1
    decimal = dialect.decimal
    if options.decimal is None and _may_have_commas(dialect, tied, sample):
        decimal = _late_decimal(place, lines[first:], comments)
    data = [lines[number] for number in candidates if number >= first]
    rows = [dialect.cells(line) for line in data[:SAMPLE_LINES]]
    last_rows = [dialect.cells(line) for line in data[-SAMPLE_LINES:]]
    headers, units = _aligned(place, dialect, rows[:3])
    if headers and not any(units):
        units = _units_apart(lines[:first], headers, dialect)
    if not headers:
        _refuse_samples_across(place, dialect, len(data))
        if options.header_lines is None:
            _ask_about_numbered_columns(place, rows)
    labels = []
    for line in lines[:first]:
        labels += labelled(line, comments)
    return replace(
        dialect,
        decimal=decimal,
        headers=headers,
        units=units,
        writings=_writings(last_rows, dialect),
        repeated_header=find_repeated_header(lines, first, dialect.delimiter),
        sparse=_is_sparse(last_rows, dialect),
        labels=tuple(labels),
    )


def _lines_of(head: bytes) -> list[str]:
    """Return the lines of a text without their ends."""
    lines = [decoded(line.removesuffix(b"\r")) for line in head.split(b"\n")]
    lines[0] = lines[0].removeprefix("\ufeff")
    if not lines[-1]:
        lines.pop()
    return lines


def _candidates(lines: Sequence[str], comments: str, skip: int) -> list[int]:
    """Return the numbers (from 0) of the lines that may be rows or headers."""
    candidates = []
    for number in range(skip, len(lines)):
        if not is_comment(lines[number], comments):
            candidates.append(number)
    return candidates


def _refuse_no_numbers(place: str, lines: Sequence[str]) -> NoReturn:
    """Refuse a log without a line of numbers (InputError)."""
    for line in reversed(lines):
        match = _NUMBER_WITH_UNIT.search(line)
        if match is not None:
            raise InputError(
                f"{place}: no line holds plain numbers, but '{match[0]}' ({_PLAIN_NUMBERS})"
            )
    raise InputError(f"{place}: no data rows: no line holds numbers")


def _refuse_samples_across(place: str, dialect: Dialect, rows: int) -> None:
    """Refuse a log whose few lines hold a name and many samples each (InputError)."""
    named_in_front = 0 not in dialect.numeric
    if named_in_front and dialect.width > max(_MOST_ACROSS, rows):
        raise InputError(
            f"{place}: the samples run along the lines, {dialect.width - 1:,} in each: turn it round "
            "(pandas: read_csv(FILE, header=None, index_col=0).T)"
        )


def labelled(line: str, comments: str, units: bool = True) -> list[tuple[str, str]]:
    """Return the label of a comment that names columns (or units), with what follows it; else nothing."""
    body = line.strip().lstrip(comments).strip()
    if line.strip()[:1] not in comments:
        return []
    label = _LABEL.match(body)
    if label is None or (label["unit"] and not units):
        return []
    return [(label[0], body[label.end() :])]


def _is_sparse(rows: list[list[str]], dialect: Dialect) -> bool:
    """Return whether every row leaves a cell empty in which other rows have a number."""
    if dialect.delimiter == BLANKS:
        return False
    numbers = []  # the columns in which each row has one
    for row in rows:
        columns = set()
        for column, cell in enumerate(row[: dialect.width]):
            if is_number(cell, dialect.decimal):
                columns.add(column)
        numbers.append(columns)
    if not numbers:
        return False
    partly = numbers[0].union(*numbers) - numbers[0].intersection(*numbers)
    if not partly:
        return False
    for row in rows:
        cells = row[: dialect.width]
        if not any(column < len(cells) and not cells[column] for column in partly):
            return False
    return True


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
    written = first
    if not first[0]:
        written = first[1:]
    from_0 = [str(number) for number in range(len(written))]
    from_1 = [str(number + 1) for number in range(len(written))]
    if written not in (from_0, from_1) or len(written) < 2:
        return
    whole = 0
    others = 0
    for row in rest:
        for cell in row[-len(written) :]:
            if re.fullmatch(r"[-+]?\d*", cell):
                whole += 1
            else:
                others += 1
    if others and (not whole or len(written) > 2):
        raise InputError(
            f"{place}: the first row, {','.join(written)}, counts the columns: are these names or a sample? "
            "(`header_lines` 1 or 0)"
        )


def _writings(rows: list[list[str]], dialect: Dialect) -> tuple[str, ...]:
    """Find the columns of time stamps; empty where there are none."""
    texts = sorted(set(range(dialect.width)) - dialect.numeric)
    if not texts:
        return ()
    rows = [row for row in rows if len(row) >= dialect.width]
    writings = {column: writing_of([row[column] for row in rows]) for column in texts}
    if not any(writings.values()):
        return ()
    return tuple(writings.get(column) or "numbers" for column in range(dialect.width))


def _readings(
    sample: Sequence[str], comments: str, options: ReadingOptions
) -> list[Dialect]:
    """Read the last lines with every delimiter and decimal sign that may be meant."""
    signs = [".", ","]
    if options.decimal_sign is not None:
        signs = [options.decimal_sign]
    readings = []
    for sign in signs:
        for mark in _delimiters(options):
            if not _may_separate(mark, sign, sample, options):
                continue
            reading = _reading(sample, mark, sign, comments)
            if reading is not None:
                readings.append(reading)
    return readings


def _may_separate(
    mark: str, sign: str, sample: Sequence[str], options: ReadingOptions
) -> bool:
    """Return whether a delimiter is worth trying with a decimal sign."""
    if mark == "," and sign == ".":
        return True  # one column has no delimiter at all, and is read so
    if mark == sign:
        return False
    if options.delimiter_character is not None or mark == BLANKS:
        return True
    return any(mark in line for line in sample)


def _reading(
    sample: Sequence[str], delimiter: str, decimal: str, comments: str
) -> Dialect | None:
    """Read lines with one delimiter and decimal sign; None where no column holds numbers."""
    if any(line.count(delimiter) > _MOST_COLUMNS for line in sample):
        return None
    rows = [split_cells(line, delimiter) for line in sample]
    verdicts = [[is_number(cell, decimal) for cell in row] for row in rows]
    numbered = [number for number, verdict in enumerate(verdicts) if any(verdict)]
    if not numbered:
        return None
    shares: dict[int, float] = {}
    votes: dict[int, float] = defaultdict(float)
    for number in numbered:
        filled = [cell for cell in rows[number] if cell]
        shares[number] = sum(verdicts[number]) / len(filled)
        # a key beside its value counts half of a full row of numbers
        votes[len(rows[number])] += shares[number]
    width = max(votes, key=lambda count: (votes[count], count))
    usual = [number for number in numbered if len(rows[number]) == width]
    numeric = set()
    for column in range(width):
        count = sum(verdicts[number][column] for number in usual)
        if 2 * count >= len(usual):
            numeric.add(column)
    if not numeric:
        return None
    score = sum(shares[number] for number in usual) / len(sample)
    return Dialect(
        delimiter, decimal, comments, width, 1, (), (), frozenset(numeric), score=score
    )


def _best_readings(readings: Sequence[Dialect]) -> list[Dialect]:
    """Return the readings that no other one outdoes."""
    best = max(reading.score for reading in readings)
    tied = [reading for reading in readings if reading.score >= best - 1e-12]
    # Single tabs read as blanks, too; a header with one name too few must not be taken
    # apart at its words.
    tabs = {reading.width for reading in tied if reading.delimiter == "\t"}
    return [
        reading
        for reading in tied
        if reading.delimiter != BLANKS or reading.width not in tabs
    ]


def _may_have_commas(
    dialect: Dialect, tied: Sequence[Dialect], sample: Sequence[str]
) -> bool:
    """Return whether the sample leaves open that commas further down are decimal signs."""
    if dialect.delimiter == ",":
        return False
    signs = {tie.decimal for tie in tied if tie.delimiter == dialect.delimiter}
    if len(signs) > 1:
        return True
    return dialect.decimal == "." and _holds_whole_numbers(dialect, sample)


def _holds_whole_numbers(dialect: Dialect, sample: Sequence[str]) -> bool:
    """Return whether every cell in the usual rows of a sample is a whole number."""
    for line in sample:
        cells = dialect.cells(line)
        numbered = any(is_number(cell, dialect.decimal) for cell in cells)
        if len(cells) != dialect.width or not numbered:
            continue
        for cell in filter(None, cells):
            if not cell.lstrip("+-").isdigit():
                return False
    return True


def _with_header(
    dialect: Dialect,
    lines: Sequence[str],
    candidates: Sequence[int],
    options: ReadingOptions,
) -> Dialect:
    """Find where the data begin, and the header above them."""
    if options.header_lines is not None or options.skip_lines is not None:
        return _with_forced_header(dialect, lines, candidates, options)
    good = _first_good_row(dialect, lines, candidates)
    above = [number for number in candidates if number < good]
    rows = {number: dialect.cells(lines[number]) for number in (*above, good)}
    numbered = [number for number in above if _some_numbers(rows[number], dialect)]
    header = [number for number in above if _header_like(rows[number], dialect)]
    if not header:
        return _with_other_header(dialect, lines, rows, numbered, good)
    first = next((number for number in numbered if number > header[-1]), good)
    names, units = _names_and_units(rows, above, header)
    fits = 2 if len(_trimmed(names, dialect.width)) == dialect.width else 1
    passed = [number for number in above if header[-1] < number < first]
    over = header[-1] - 1
    if over in header and _has_units(rows[over]) and not (units or _has_units(names)):
        passed.insert(0, header[-1])  # the names may be a row without numbers
    passed = [number for number in passed if not _is_ruled(rows[number])]
    return _headed(dialect, lines, first, names, units, fits, passed)


def _first_good_row(
    dialect: Dialect, lines: Sequence[str], candidates: Sequence[int]
) -> int:
    """Find the first line with a number in every column of numbers, or else in one of them."""
    for number in candidates:
        cells = dialect.cells(lines[number])
        if len(cells) != dialect.width:
            continue
        if all(is_number(cells[column], dialect.decimal) for column in dialect.numeric):
            return number
    # rows are there, but every one of them has a bad cell
    for number in candidates:
        if _some_numbers(dialect.cells(lines[number]), dialect):
            return number
    raise AssertionError("a dialect is detected from lines of numbers")


def _with_other_header(
    dialect: Dialect,
    lines: Sequence[str],
    rows: Mapping[int, list[str]],
    numbered: Sequence[int],
    good: int,
) -> Dialect:
    """Find where the data begin where no line above them is separated as they are."""
    # What a blank line separates from the data are key-value lines of an instrument.
    blank = -1
    for number in range(good):
        if not lines[number].strip():
            blank = number
    first = good
    for number in numbered:
        if len(rows[number]) == dialect.width and number > blank:
            first = number
            break
    names, units = _other_header(lines, first, dialect)
    passed = []  # rows of nothing but delimiters
    for number, cells in rows.items():
        if number < first and len(cells) == dialect.width and not any(cells):
            passed.append(number)
    fits = 2 if names else 0
    return _headed(dialect, lines, first, names, units, fits, passed)


def _headed(
    dialect: Dialect,
    lines: Sequence[str],
    first: int,
    names: Sequence[str],
    units: Sequence[str],
    fits: int,
    passed: Sequence[int] = (),
) -> Dialect:
    """Return a dialect whose rows begin at line ``first`` (from 0), with its header."""
    texts = tuple((number + 1, lines[number].strip()) for number in passed)
    return replace(
        dialect,
        first_line=first + 1,
        headers=tuple(names),
        units=tuple(units),
        fits=fits,
        passed=texts,
    )


def _has_units(names: list[str]) -> bool:
    return any(split_header(name)[1] is not None for name in names)


def _is_ruled(cells: list[str]) -> bool:
    """Return whether a line only divides the header from the data, as one of dashes does."""
    return any(cells) and not re.search(r"\w", "".join(cells))


def _some_numbers(cells: list[str], dialect: Dialect) -> bool:
    for column in dialect.numeric:
        if column < len(cells) and is_number(cells[column], dialect.decimal):
            return True
    return False


def _header_like(cells: list[str], dialect: Dialect) -> bool:
    """No numbers where the data have them, and about as many cells (a trailing delimiter aside)."""
    has_words = any(re.search(r"\w", cell) for cell in cells)
    if _some_numbers(cells, dialect) or not has_words:
        return False
    return abs(len(cells) - dialect.width) <= 1 and len(cells) >= min(dialect.width, 2)


def _names_and_units(
    rows: dict[int, list[str]], above: list[int], header: list[int]
) -> tuple[list[str], list[str]]:
    """Find the line of names from a line of units below it (and one of remarks below that)."""
    last = header[-1]
    for number in (last, last - 1, last - 2):
        if number not in header:
            break
        units = _units_in(rows[number])
        if not units:
            continue
        over = _words_above(rows, above, number)
        if over and abs(len(over) - len(units)) <= 1 and not _units_in(over):
            return over, units
        if number < last:
            return rows[last], units
        return rows[number], []
    return rows[last], []


def _words_above(
    rows: dict[int, list[str]], above: list[int], number: int
) -> list[str]:
    """Return the next line above that is none of dashes; nothing where there is none."""
    for higher in reversed(above[: above.index(number)]):
        if re.search(r"\w", "".join(rows[higher])):
            return rows[higher]
    return []


def _units_in(cells: list[str]) -> list[str]:
    """Return the cells of a line of units, a label in front (``Units: s``) aside; empty for any other."""
    if not cells:
        return []
    label = _LABEL.match(cells[0])
    if label is not None and label["unit"]:
        cells = [cells[0][label.end() :], *cells[1:]]
    known = 0
    for cell in cells:
        if not cell.strip("[](){}<> -"):
            continue
        if not is_known_unit(cell.strip("[](){}<> ")):
            return []
        known += 1
    return cells if known else []


def _units_apart(
    above: Sequence[str], names: tuple[str, ...], dialect: Dialect
) -> tuple[str, ...]:
    """Find units that stand apart from the names: in a comment, or one a line (``Voltage unit: mV``)."""
    comments = dialect.comments
    stated = {}
    for line in above:
        body = line.strip().lstrip(comments).strip()
        label = _LABEL.match(body)
        match = _UNIT_OF_ONE.fullmatch(body)
        if match is not None and is_known_unit(match["unit"].strip("[]()")):
            stated[match["name"].lower()] = match["unit"]
        elif (label is not None and label["unit"]) or line.strip()[:1] in comments:
            text = body
            if label is not None:
                text = body[label.end() :]
            cells = _fitting_cells(text, dialect)
            if cells is not None and _units_in(cells):
                return tuple(cells)
    units = tuple(stated.get(name.lower(), "") for name in names)
    return units if any(units) else ()


def _other_header(
    lines: Sequence[str], first: int, dialect: Dialect
) -> tuple[list[str], list[str]]:
    """Look for a header in the comment lines, or the differently separated line, right above the data."""
    comments = dialect.comments
    for text in reversed(lines[:first]):
        for _, names in labelled(text, comments, units=False):  # JPK's and Qudi's
            cells = _fitting_cells(names.strip("'").replace(";;", ";"), dialect)
            if cells is not None:
                return cells, []
    headers: list[list[str]] = []
    for number in range(first - 1, max(-1, first - 4), -1):
        text = lines[number].strip()
        body = text
        if text and text[0] in comments:
            body = text.lstrip(comments).strip()
        if body.isdigit() and body != text and number == first - 1:
            continue  # QCoDeS counts its rows there
        cells = _fitting_cells(body, dialect)
        if not body or cells is None:
            break
        headers.append(cells)
    if not headers:
        return [], []
    if len(headers) > 1 and _units_in(headers[0]) and not _units_in(headers[1]):
        return headers[1], headers[0]
    return headers[0], []


def _fitting_cells(text: str, dialect: Dialect) -> list[str] | None:
    """Split a header line in the way that gives as many cells as the data have columns."""
    for cells in _splits(text, dialect.delimiter):
        if len(cells) != dialect.width or not all(cells):
            continue
        if not any(is_number(cell, dialect.decimal) for cell in cells):
            return cells
    return None


def _splits(text: str, delimiter: str) -> Iterator[list[str]]:
    """Split a header line in every way that may be meant, the likeliest first."""
    wide_blanks = [cell.strip() for cell in re.split(r"\s{2,}|\t+", text)]
    if delimiter != BLANKS and delimiter in text:
        # taken apart at blanks, a header with one name too few would shift all others
        yield split_cells(text, delimiter)
        yield wide_blanks
        return
    for mark in ("\t", ";", ",", "|"):
        if mark in text:
            yield split_cells(text, mark)
    yield split_cells(text, delimiter)
    yield wide_blanks
    with_units = re.findall(r"[^\s(\[]+\s*(?:[(\[][^)\]]{0,60}[)\]])?", text)
    yield [cell.strip() for cell in with_units]
    yield text.split()


def _with_forced_header(
    dialect: Dialect,
    lines: Sequence[str],
    candidates: Sequence[int],
    options: ReadingOptions,
) -> Dialect:
    """Take as many header lines as the user said, or as have no numbers, at most two."""
    count = options.header_lines
    if count is None:
        rows = [dialect.cells(lines[number]) for number in candidates[:2]]
        most = 1
        if len(rows) > 1 and _units_in(rows[1]):
            most = 2
        without = [row for row in rows if not _some_numbers(row, dialect)]
        count = min(len(without), most)
    if len(candidates) <= count:
        return _headed(dialect, lines, len(lines), [], [], 0)
    header = []
    for number in candidates[:count]:
        line = lines[number]
        header.append(_fitting_cells(line, dialect) or dialect.cells(line))
    names = header[0] if count else []
    units = header[1] if count > 1 else []
    return _headed(dialect, lines, candidates[count], names, units, 1)


def _trimmed(cells: list[str], width: int) -> list[str]:
    """Take off what a trailing delimiter adds, and the header of a comment column that the rows leave out."""
    while len(cells) > width and (not cells[-1] or cells[-1].lower() == "comment"):
        cells = cells[:-1]
    return cells


def _aligned(
    place: str, dialect: Dialect, rows: list[list[str]]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Bring the header to the width of the rows, or refuse one that cannot be meant for them."""
    width = dialect.width
    names = _trimmed(list(dialect.headers), width)
    if names and len(names) == width - 1:
        if rows and not rows[0][-1]:
            names = [*names, ""]  # the rows end with a delimiter
        elif rows and _are_numbered(rows):
            names = ["", *names]  # their column has no name
    if names and len(names) != width:
        raise InputError(
            f"{place}:{dialect.first_line}: {width} cells where the header names {len(names)} columns "
            "(check the delimiter, or skip the lines above the data with `skip_lines`)"
        )
    units = _trimmed(list(dialect.units), width)
    if units:
        units = [*units, *[""] * (width - len(units))][:width]
    return tuple(name.strip() for name in names), tuple(units)


def _are_numbered(rows: list[list[str]]) -> bool:
    """Return whether the first cells of rows count them from 1."""
    for number, row in enumerate(rows, start=1):
        if row[0] != str(number):
            return False
    return True


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
