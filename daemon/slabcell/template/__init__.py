"""Which polygons are to be laid?  Templates: CSV files, or drawings that become one.

The cell's truth is the CSV file (`csv_file`).  A DXF drawing (`dxf`) is read into the same polygons and written as CSV,
so that what people check, version and hash has one form.  `checks` says what is wrong with polygons wherever they come
from; every fault is a `Problem` with its place in the file and on the pattern.
"""

from slabcell.template.csv_file import MAX_BYTES, examine_csv, load_template, parse_template, read_file
from slabcell.template.model import Examined, Problem, Template

__all__ = [
    "MAX_BYTES",
    "Examined",
    "Problem",
    "Template",
    "examine_csv",
    "load_template",
    "parse_template",
    "read_file",
]
