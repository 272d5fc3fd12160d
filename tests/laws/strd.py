"""Linear regression problems of NIST's Statistical Reference Datasets, with their certified results.

The numbers are kept as text, as published: arithmetic of any precision can read them without a rounding error.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["PROBLEMS", "Certified"]


@dataclass(frozen=True)
class Certified:
    """y = X b + e, where the columns of X are the ``powers`` of each of the ``predictors``.

    Certified are ``coefficients`` and their standard deviations ``errors``, one per column, and the standard deviation
    ``residual`` of the residuals.
    """

    name: str
    y: tuple[str, ...]
    predictors: tuple[tuple[str, ...], ...]
    powers: tuple[int, ...]
    coefficients: tuple[str, ...]
    errors: tuple[str, ...]
    residual: str

    def columns(self, number: Callable[[str], Any]) -> list[list[Any]]:
        """Return the columns of X in the arithmetic of ``number``."""
        return [[number(x) ** k for x in predictor] for predictor in self.predictors for k in self.powers]

    @property
    def X(self) -> NDArray[np.float64]:
        """The matrix (rows, coefficients) in double precision."""
        return np.array(self.columns(float)).T


def words(text: str) -> tuple[str, ...]:
    return tuple(text.split())


def decimals(values: Iterable[int], digits: int = 0) -> tuple[str, ...]:
    """Write whole multiples of 10^-digits without rounding."""
    return tuple(f"{value}e-{digits}" for value in values)


LONGLEY = """
83.0 234289 2356 1590 107608 1947   88.5 259426 2325 1456 108632 1948   88.2 258054 3682 1616 109773 1949
89.5 284599 3351 1650 110929 1950   96.2 328975 2099 3099 112075 1951   98.1 346999 1932 3594 113270 1952
99.0 365385 1870 3547 115094 1953  100.0 363112 3578 3350 116219 1954  101.2 397469 2904 3048 117388 1955
104.6 419180 2822 2857 118734 1956 108.4 442769 2936 2798 120445 1957  110.8 444546 4681 2637 121950 1958
112.6 482704 3813 2552 123366 1959 114.2 502601 3931 2514 125368 1960  115.7 518173 4806 2572 127852 1961
116.9 554894 4007 2827 130081 1962
"""

FILIP_X = """
-6.860120914 -4.324130045 -4.358625055 -4.358426747 -6.955852379 -6.661145254 -6.355462942 -6.118102026 -7.115148017
-6.815308569 -6.519993057 -6.204119983 -5.853871964 -6.109523091 -5.79832982 -5.482672118 -5.171791386 -4.851705903
-4.517126416 -4.143573228 -3.709075441 -3.499489089 -6.300769497 -5.953504836 -5.642065153 -5.031376979 -4.680685696
-4.329846955 -3.928486195 -8.56735134 -8.363211311 -8.107682739 -7.823908741 -7.522878745 -7.218819279 -6.920818754
-6.628932138 -6.323946875 -5.991399828 -8.781464495 -8.663140179 -8.473531488 -8.247337057 -7.971428747 -7.676129393
-7.352812702 -7.072065318 -6.774174009 -6.478861916 -6.159517513 -6.835647144 -6.53165267 -6.224098421 -5.910094889
-5.598599459 -5.290645224 -4.974284616 -4.64454848 -4.290560426 -3.885055584 -3.408378962 -3.13200249 -8.726767166
-8.66695597 -8.511026475 -8.165388579 -7.886056648 -7.588043762 -7.283412422 -6.995678626 -6.691862621 -6.392544977
-6.067374056 -6.684029655 -6.378719832 -6.065855188 -5.752272167 -5.132414673 -4.811352704 -4.098269308 -3.66174277
-3.2644011
"""
FILIP_Y = """
0.8116 0.9072 0.9052 0.9039 0.8053 0.8377 0.8667 0.8809 0.7975 0.8162 0.8515 0.8766 0.8885 0.8859 0.8959 0.8913 0.8959
0.8971 0.9021 0.9090 0.9139 0.9199 0.8692 0.8872 0.8900 0.8910 0.8977 0.9035 0.9078 0.7675 0.7705 0.7713 0.7736 0.7775
0.7841 0.7971 0.8329 0.8641 0.8804 0.7668 0.7633 0.7678 0.7697 0.7700 0.7749 0.7796 0.7897 0.8131 0.8498 0.8741 0.8061
0.8460 0.8751 0.8856 0.8919 0.8934 0.8940 0.8957 0.9047 0.9129 0.9209 0.9219 0.7739 0.7681 0.7665 0.7703 0.7702 0.7761
0.7809 0.7961 0.8253 0.8602 0.8809 0.8301 0.8664 0.8834 0.8898 0.8964 0.8963 0.9074 0.9119 0.9228
"""

PONTIUS_Y = """
.11019 .21956 .32949 .43899 .54803 .65694 .76562 .87487 .98292 1.09146 1.20001 1.30822 1.41599 1.52399 1.63194 1.73947
1.84646 1.95392 2.06128 2.16844
.11052 .22018 .32939 .43886 .54798 .65739 .76596 .87474 .98300 1.09150 1.20004 1.30818 1.41613 1.52408 1.63159 1.73965
1.84696 1.95445 2.06177 2.16829
"""


def longley() -> Certified:
    table = words(LONGLEY)
    return Certified(
        "Longley",
        words("60323 61122 60171 61187 63221 63639 64989 63761 66019 67857 68169 66513 68655 69564 69331 70551"),
        (("1",) * 16, *(table[k::6] for k in range(6))),
        (1,),
        words(
            "-3482258.63459582 15.0618722713733 -0.358191792925910E-01 -2.02022980381683 -1.03322686717359 "
            "-0.511041056535807E-01 1829.15146461355"
        ),
        words(
            "890420.383607373 84.9149257747669 0.334910077722432E-01 0.488399681651699 0.214274163161675 "
            "0.226073200069370 455.478499142212"
        ),
        "304.854073561965",
    )


def filip() -> Certified:
    return Certified(
        "Filip",
        words(FILIP_Y),
        (words(FILIP_X),),
        tuple(range(11)),
        words(
            "-1467.48961422980 -2772.17959193342 -2316.37108160893 -1127.97394098372 -354.478233703349 "
            "-75.1242017393757 -10.8753180355343 -1.06221498588947 -0.670191154593408E-01 -0.246781078275479E-02 "
            "-0.402962525080404E-04"
        ),
        words(
            "298.084530995537 559.779865474950 466.477572127796 227.204274477751 71.6478660875927 15.2897178747400 "
            "2.23691159816033 0.221624321934227 0.142363763154724E-01 0.535617408889821E-03 0.896632837373868E-05"
        ),
        "0.334801051324544E-02",
    )


def pontius() -> Certified:
    return Certified(
        "Pontius",
        words(PONTIUS_Y),
        (decimals(range(150000, 3000001, 150000)) * 2,),
        (0, 1, 2),
        words("0.673565789473684E-03 0.732059160401003E-06 -0.316081871345029E-14"),
        words("0.107938612033077E-03 0.157817399981659E-09 0.486652849992036E-16"),
        "0.205177424076185E-03",
    )


def no_intercept() -> tuple[Certified, Certified]:
    x1, y1 = decimals(range(60, 71)), decimals(range(130, 141))
    first = Certified("NoInt1", y1, (x1,), (1,), ("2.07438016528926",), ("0.165289256198347E-01",), "3.56753034006338")
    second = Certified(
        "NoInt2",
        words("3 4 4"),
        (words("4 5 6"),),
        (1,),
        ("0.727272727272727",),
        ("0.420827318078432E-01",),
        "0.369274472937998",
    )
    return first, second


def wampler(name: str, y: tuple[str, ...], coefficients: str, errors: Iterable[str], residual: str) -> Certified:
    """A polynomial of degree 5 at x = 0 ... 20."""
    return Certified(name, y, (decimals(range(21)),), tuple(range(6)), words(coefficients), tuple(errors), residual)


def wamplers() -> tuple[Certified, ...]:
    """The third to fifth differ by a disturbance that is multiplied by 1, 100 and 10000, and so are their errors."""
    exact = [sum(x**k for k in range(6)) for x in range(21)]
    falling = [sum(x**k * 10 ** (5 - k) for k in range(6)) for x in range(21)]
    half = [759, -2048, 2048, -2048, 2523, -2048, 2048, -2048, 1838, -2048]
    disturbance = [*half, 2048, *reversed(half)]
    ones, zeros = "1 1 1 1 1 1", ("0",) * 6
    errors = words(
        "2152.32624678170 2363.55173469681 779.343524331583 101.475507550350 5.64566512170752 0.112324854679312"
    )

    def disturbed(number: int, power: int) -> Certified:
        y = decimals(a + 10**power * b for a, b in zip(exact, disturbance, strict=True))
        scaled = (f"{error}e{power}" for error in errors)
        return wampler(f"Wampler{number}", y, ones, scaled, f"2360.14502379268e{power}")

    return (
        wampler("Wampler1", decimals(exact), ones, zeros, "0"),
        wampler("Wampler2", decimals(falling, 5), "1 1e-1 1e-2 1e-3 1e-4 1e-5", zeros, "0"),
        disturbed(3, 0),
        disturbed(4, 2),
        disturbed(5, 4),
    )


PROBLEMS = (longley(), *wamplers(), filip(), pontius(), *no_intercept())
