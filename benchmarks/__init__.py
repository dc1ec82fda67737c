"""How well and how fast: `make bench [ONLY=name]`. Every module that `__main__` names has one
function, `measure`, which gives figures; a figure that has a bound holds or does not."""
