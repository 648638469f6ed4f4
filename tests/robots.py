"""The robots that tests run over: a new file in ``models/robots/`` needs its line here."""

ROBOTS = (
    "anymal_c",
    "go2",
    "mini_cheetah",
    "solo12",
)
