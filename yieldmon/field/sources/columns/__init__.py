"""From named columns of any file to a harvest table: which column is what, in which unit, when and where."""
