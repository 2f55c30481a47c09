"""Names and units of the columns, from the lines above the rows.

The line nearest to the rows that has a cell for each column holds the names; a line of
units may stand below or in the place of it. Where there is none, makers' settings by
channel are asked.
"""

import re
from collections.abc import Collection, Sequence

from dbo_cli.logs.cells import Layout, is_number, split_cells
from dbo_cli.logs.columns import KNOWN_NAMES, words
from dbo_cli.logs.settings import (
    NAME_KEYS,
    TIME_UNIT_KEYS,
    UNIT_KEYS,
    is_channel_key,
    is_clock_setting,
    plain_key,
    read_settings,
)
from dbo_cli.logs.table import LONGEST_CELL
from dbo_cli.units import is_unit, parse_unit, spell, split_header, time_unit

_LINES = 3  # names, units and a remark stand above the rows at most
_BESIDE = 40  # rows beside which settings may stand
_LABEL = re.compile(
    r"(?:column[ _]?(?:names|headers)?|columns|names|fields|header|units?)\s*[:=]\s*",
    re.IGNORECASE,
)


def read_header(above: Sequence[str], rows: Sequence[str], layout: Layout) -> None:
    """Read names, units and the clock from the lines above the rows.

    Parameters
    ----------
    above, rows
        The lines above the rows, and the first rows.
    layout
        How the rows are written; receives what is found.
    """
    margin = []
    for line in rows[:_BESIDE]:
        cells = split_cells(line, layout.delimiter)[: min(layout.numeric)]
        margin.append(layout.delimiter.join(cells))  # where Tektronix has its settings
    layout.settings = read_settings([*above, *margin], layout.delimiter)
    layout.names, layout.units = [""] * layout.width, [""] * layout.width
    headers = _header_lines(above, layout)
    layout.is_headed = bool(headers)
    units = _units_line(headers)
    if units is not None:
        layout.units = headers[units]
        layout.names = headers[units + 1] if units + 1 < len(headers) else headers[0][:]
    elif headers:
        layout.names = headers[0]
        for cells in reversed(headers):  # a remark may stand below names
            if sum(split_header(cell)[1] is not None for cell in cells) > 1:
                layout.names = cells
    has_names = len(headers) > (units is not None)
    has_decimals = any(layout.decimal in line for line in rows[:_BESIDE])
    if len(layout.numeric) > 1 or has_decimals:  # else they are counts, and no volts
        _fill_from_settings(layout, has_names)


def _header_lines(above: Sequence[str], layout: Layout) -> list[list[str]]:
    """Return the lines right above the rows that have a cell for each column, the nearest first."""
    headers: list[list[str]] = []
    for line in reversed(above):
        plain = line.strip("\r\n ")
        if not plain.strip("#%,;\t| "):
            if headers and not plain.strip("#%"):
                break  # what stands above a blank line is no header
            continue
        if is_channel_key(split_cells(plain, layout.delimiter)[0]):
            break
        cells = split_cells(plain.lstrip("#% "), layout.delimiter)
        is_remark = any(map(_is_amount, cells))
        above_units = bool(headers) and _are_units(headers[-1])
        header = None if is_remark else _as_header(plain, layout, above_units)
        if header is not None:
            headers.append(header)
            if len(headers) == _LINES:
                break
            continue
        if headers or not (is_remark or plain[0] in "#%"):
            break
    return headers


def _as_header(line: str, layout: Layout, above_units: bool) -> list[str] | None:
    """Split a line above the rows into as many cells as they have; None where that cannot be done.

    Names above a line of units may be numbers (an oscilloscope's channels).
    """
    if len(line) > LONGEST_CELL * layout.width:
        return None
    is_comment = line[0] in "#%"
    if is_comment:
        line = line.lstrip("#% \t")
    label = _LABEL.match(line)
    if label:
        line = line[label.end() :]
    elif is_comment and re.match(r"[\w .]+=", line):
        return None  # a setting
    is_labelled = bool(label) or above_units
    for cells in _ways_to_split(line, layout.delimiter, is_comment, is_labelled):
        cells = _fitted([cell.strip("'") for cell in cells], layout)
        is_text = any(cell and not is_number(cell, ".") for cell in cells)
        if len(cells) != layout.width or not is_text:
            continue
        figures = {cells[n] for n in layout.numeric if is_number(cells[n])}
        if above_units or not figures or (figures == {"1"} and _are_units(cells)):
            return cells  # 1 stands for no unit
    return None


def _ways_to_split(
    line: str, delimiter: str, is_comment: bool, is_labelled: bool
) -> list[list[str]]:
    """Return how a line may be split: as the rows, and in other ways beside blanks or in a comment.

    At single blanks it is split only where a label, units below, quotes or all words say that it is no title.
    """
    ways = [] if delimiter == " " else [split_cells(line, delimiter)]
    if is_comment or delimiter == " ":
        ways = [split_cells(line, mark) for mark in ";," if mark in line] + ways
        ways.append([cell.strip() for cell in re.split(r"\s{2,}|\t", line)])
        with_units = re.findall(r"[^\s(\[]+(?:\s*[(\[][^)\]]*[)\]])?", line)
        for cells in (split_cells(line, " "), with_units):
            if is_labelled or '"' in line or all(map(_is_name, cells)):
                ways.append(cells)
    return ways


def _is_name(word: str) -> bool:
    """Return whether a word names a column: a known one, a letter, or with a unit, a digit or ``_``."""
    if len(word) == 1 or re.search(r"[\d_]", word) or split_header(word)[1]:
        return True
    return is_unit(word) or bool(words(word) & KNOWN_NAMES)


def are_names(cells: Sequence[str]) -> bool:
    """Return whether all cells are texts, and most of them have a unit or a known word."""
    if any(map(is_number, cells)) or not all(cells):
        return False
    recognised = [c for c in cells if split_header(c)[1] or words(c) & KNOWN_NAMES]
    return 2 * len(recognised) > len(cells)


def _is_amount(cell: str) -> bool:
    """Return whether a cell is an amount and no name: ``0.1 mm``, ``Range: 0 V to 100 V``, ``2 mV rms``."""
    amount = re.split("[:=]", cell)[-1]
    match = re.fullmatch(
        r"[^\w.,]*\d[\d.,]*(?:[eE][-+]?\d+)?\s*([^\W\d_]+)[^\[]*", amount
    )
    is_short = all(len(word) < 4 for word in words(amount))
    return match is not None and is_short and parse_unit(match[1]) is not None


def begins_run(comment: str) -> bool:
    """Return whether a comment among the rows states a setting or names, as above another run."""
    return bool(re.search("[:=]", comment) or words(comment) & KNOWN_NAMES)


def _fitted(cells: list[str], layout: Layout) -> list[str]:
    """Leave out cells that belong to no column, and put in those that have no name."""
    are_units = _are_units(cells[: layout.width])
    while len(cells) > layout.width:
        is_remark = cells[-1].lower() in ("", "comment") or is_clock_setting(cells[-1])
        is_value = are_units and is_number(cells[-1], ".")  # of a key beside units
        if not (is_remark or is_value):
            break
        cells.pop()
    last = split_cells(layout.first_line, layout.delimiter)[-1]
    if len(cells) == layout.width - 1 > 0 and not last:
        return [*cells, ""]  # the rows end in a delimiter
    return cells


def _units_line(headers: Sequence[Sequence[str]]) -> int | None:
    """Return which line holds units: units alone, or for the most part below names (``s;mV;nm;nm/s``)."""
    for k, cells in enumerate(headers):
        if _are_units(cells):
            return k
    for k, cells in enumerate(headers[:-1]):
        nonempty = [cell for cell in cells if cell.strip("()[]- ")]
        recognised = [cell for cell in nonempty if is_unit(cell)]
        is_long = any(len(spell(cell) or "") > 1 for cell in recognised)
        is_below = are_names(headers[k + 1])
        if 2 * len(recognised) > len(nonempty) and (is_long or is_below):
            return k
    return None


def _are_units(cells: Sequence[str]) -> bool:
    """Return whether every filled cell is a known unit (a label in front and numbers aside)."""
    nonempty = [cell for cell in cells if cell.strip("()[]- ")]
    if nonempty and re.fullmatch(r"units?:?|sequence", nonempty[0].lower()):
        nonempty = nonempty[1:]
    texts = [cell for cell in nonempty if not is_number(cell, ".")]
    return bool(texts) and all(map(is_unit, texts))


def _fill_from_settings(layout: Layout, has_names: bool) -> None:
    """Take names and units that are stated by channel where no line above the rows has them."""
    time = _stated_by_channel(layout, TIME_UNIT_KEYS)
    has_units = any(layout.units) or any(split_header(name)[1] for name in layout.names)
    places = layout.numeric
    # a single statement is the file's, or that of the one column beside the time
    fewest = 1 if time and len(places) < 3 else 2
    columns = []
    if not has_names:
        columns.append((layout.names, NAME_KEYS))
    if not has_units:
        columns.append((layout.units, UNIT_KEYS))
    for cells, keys in columns:
        statements = _stated_by_channel(layout, keys)
        count = len(statements)
        if count >= fewest and count in (len(places), len(places) - 1):
            for index, text in zip(places[-count:], statements, strict=True):
                cells[index] = text
    is_free = not has_units and any(layout.units) and not layout.units[places[0]]
    if is_free and time and time_unit(time[0]):
        layout.units[places[0]] = time[0]


def _stated_by_channel(layout: Layout, keys: Collection[str]) -> list[str]:
    """Return what the last setting of a key states of each channel."""
    statements: list[str] = []
    for key, values in layout.settings.items():
        nonempty = [value for value in values if value and value != key]
        if plain_key(key) not in keys or not nonempty:
            continue
        statements = nonempty
        if len(values) + 1 == layout.width and key in values:  # in the columns' places
            statements = ["" if value == key else value for value in (key, *values)]
    return statements
