"""Export results to other programs: tables by frame, point or track, MATLAB files, and maps on a grid."""

from fingerflow.results.tables.table_files import export_map as export_map
from fingerflow.results.tables.table_files import export_table as export_table
from fingerflow.results.tables.table_files import is_table as is_table
