"""The repaired simulator as files of others: a patch of the user's MJCF, and mujoco-sysid."""

from candata.repair.mjcf import MjcfExport, export_mjcf
from candata.repair.sysid import SysidExport, export_sysid

__all__ = ["MjcfExport", "SysidExport", "export_mjcf", "export_sysid"]
