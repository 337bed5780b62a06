"""All cases, in the order of the report. A new case is a file and a line here."""

from experiments.validation.case import Case
from experiments.validation.cavity import Cavity
from experiments.validation.channel_cylinder import ChannelCylinder
from experiments.validation.compressibility import Compressibility
from experiments.validation.d_cylinder import HalfDisc
from experiments.validation.free_cylinder import FreeCylinder
from experiments.validation.gaits import Gaits
from experiments.validation.invariance import Invariance
from experiments.validation.oscillating_cylinder import OscillatingCylinder
from experiments.validation.outflow import Outflow
from experiments.validation.poiseuille import Poiseuille
from experiments.validation.settling_disc import SettlingDisc
from experiments.validation.sheared_ellipse import ShearedEllipse
from experiments.validation.slip import Slip
from experiments.validation.stability import Stability
from experiments.validation.swimmer import Swimmer
from experiments.validation.taylor_green import TaylorGreen
from experiments.validation.turning import Turning

CASES: tuple[Case, ...] = (
    TaylorGreen(),
    Poiseuille(),
    Cavity(),
    Invariance(),
    Slip(),
    ChannelCylinder(),
    FreeCylinder(),
    HalfDisc(),
    Outflow(),
    OscillatingCylinder(),
    SettlingDisc(),
    ShearedEllipse(),
    Swimmer(),
    Gaits(),
    Turning(),
    Compressibility(),
    Stability(),
)
