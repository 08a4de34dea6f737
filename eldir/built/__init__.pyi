from .motion import drive as drive
from .robot import build as build
from .walking import walk as walk
