"""`sunpy.timeseries.TimeSeries("aspect.fits")`: the pointing at a constant rate."""

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING, Any

import astropy.units as u
import pandas
from astropy.table import Table
from astropy.time import Time
from sunpy.timeseries import GenericTimeSeries
from sunpy.util.metadata import MetaDict

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["PointingTimeSeries"]


def _is_pointing(meta: MetaDict) -> bool:
    return meta.get("extname") == "POINTING" and meta.get("instrume") == "solar aspect camera"


class PointingTimeSeries(GenericTimeSeries):  # type: ignore[misc]
    """The table POINTING of a refined flight, without its columns of text. docs/refine-reference.md lists the columns."""

    _source = "solaspect"

    @classmethod
    def is_datasource_for(cls, **kwargs: Any) -> bool:
        return _is_pointing(MetaDict(kwargs.get("meta") or {}))

    @classmethod
    def _parse_hdus(cls, pairs: list[Any]) -> tuple[pandas.DataFrame, MetaDict, OrderedDict[str, u.Unit]]:
        data, header = next((pair.data, meta) for pair in pairs if _is_pointing(meta := MetaDict(pair.header)))
        table = Table(data)
        names = [name for name in table.colnames if name != "TIME" and table[name].dtype.kind != "S"]
        times = Time(header["MJDREF"], table["TIME"] / 86400, format="mjd", scale="utc")
        values = {name: table[name].astype(table[name].dtype.newbyteorder("=")) for name in names}
        columns = [header[f"TTYPE{n}"] for n in range(1, header["TFIELDS"] + 1)]
        units = OrderedDict((name, u.Unit(header.get(f"TUNIT{columns.index(name) + 1}", ""))) for name in names)
        return pandas.DataFrame(values, index=pandas.DatetimeIndex(times.to_value("datetime64"))), header, units

    def plot(self, axes: Axes | None = None, columns: list[str] | None = None, **kwargs: Any) -> Axes:
        """Draw columns: the boresight's longitude and latitude if none are named."""
        return super().plot(axes=axes, columns=columns or ["HPLN", "HPLT"], **kwargs)
