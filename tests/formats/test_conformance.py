"""Every format keeps what all formats must."""

import pytest

from candata.formats import FORMATS
from candata.testing import FormatConformance
from tests.formats.made_sets import foundationpose_source, table_source
from tests.suites import suites

pytest.importorskip("h5py")

#: What some differ in: formats that are only read bring a source; text and matrices have no check sum.
OF = {
    "table": {"source": table_source, "exact": False},
    "foundationpose": {"source": foundationpose_source, "exact": False},
}
globals().update(suites(FormatConformance, FORMATS, "format", **OF))
