from .guardian.bank import HeaterBank as HeaterBank
from .guardian.bank import Report as Report
from .guardian.client import Guardian as Guardian
from .rig.configuration import Rig as Rig
from .run.drive import open_bank as open_bank
