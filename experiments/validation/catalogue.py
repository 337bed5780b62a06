"""All cases, in the order of the report. A new case is a file and a line here."""

from experiments.validation.case import Case
from experiments.validation.cavity import Cavity
from experiments.validation.compressibility import Compressibility
from experiments.validation.gaits import Gaits
from experiments.validation.poiseuille import Poiseuille
from experiments.validation.swimmer import Swimmer
from experiments.validation.taylor_green import TaylorGreen

CASES: tuple[Case, ...] = (
    TaylorGreen(),
    Poiseuille(),
    Cavity(),
    Swimmer(),
    Gaits(),
    Compressibility(),
)
