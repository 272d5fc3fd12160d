"""The report of an identification, one file for each part of its page."""

from dynident.report.identification.report import identification_notes, identification_page, identification_tables
