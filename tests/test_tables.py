"""Plain-text tables."""

from jaxlocomanip.tables import aligned


def test_the_first_column_goes_left_and_the_others_right():
    assert aligned([["name", "n"], ["", "100"], ["longer", "7"]]) == "name      n\n        100\nlonger    7"


def test_lines_end_with_their_text():
    assert aligned([["a", "b"], ["long", ""]]) == "a     b\nlong"
