"""The repaired simulator as files of others: a patch of the user's MJCF, and mujoco-sysid."""

from candata.repair.mjcf import Change, MjcfExport, export_mjcf, mjcf_changes
from candata.repair.sysid import SysidExport, export_sysid

__all__ = ["Change", "MjcfExport", "SysidExport", "export_mjcf", "export_sysid", "mjcf_changes"]
