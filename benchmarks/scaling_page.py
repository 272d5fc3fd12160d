"""x"""


def draw(kept):
    pass
