"""The line that shows learning on a terminal."""

from io import StringIO

from piaffe.sampling.learning.shown import shown_line


class Terminal(StringIO):
    def isatty(self):
        return True


def test_a_terminal_shows_the_last_stage_in_one_line_that_goes_at_the_end():
    stream = Terminal()
    with shown_line(stream) as show:
        show("collecting, shards", 1, 2)
        show("learning, minibatches", 30, 500)
        assert stream.getvalue().split("\r\033[K")[1:] == [
            "collecting, shards: 1 of 2",
            "learning, minibatches: 30 of 500",
        ]
    assert stream.getvalue().endswith("\r\033[K")


def test_a_log_gets_nothing():
    stream = StringIO()
    with shown_line(stream) as show:
        show("collecting, shards", 1, 2)
    assert stream.getvalue() == ""
