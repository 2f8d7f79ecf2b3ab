"""Laboratory records: one package a study, run as ``python -m studies.NAME``. Not part of the wheel."""
