"""granfabric: contact gain and loss in granular assemblies, at a point, in a field, against a DEM."""

from importlib.metadata import version

__version__ = version("granfabric")
