"""Tables in, plans out: problems from data frames, and plans and problems in the files of other programs.

`SAP.from_table`, `Result.from_plan`, `Result.to_pandas` and `Result.to_csv` are the usual ways in; the program
``sapopt export`` writes every kind of file.
"""

from sapopt.exchange.czml import write_czml
from sapopt.exchange.files import to_pandas, write_csv, write_excel, write_json, write_parquet
from sapopt.exchange.geojson import write_geojson
from sapopt.exchange.places import Places

__all__ = [
    "Places",
    "to_pandas",
    "write_csv",
    "write_czml",
    "write_excel",
    "write_geojson",
    "write_json",
    "write_parquet",
]
