"""The repaired simulator as files of others: a patch of the user's MJCF, and mujoco-sysid."""

from candata.repair.mjcf import Exported, export_mjcf
from candata.repair.sysid import SysidExport, export_sysid

__all__ = ["Exported", "SysidExport", "export_mjcf", "export_sysid"]
