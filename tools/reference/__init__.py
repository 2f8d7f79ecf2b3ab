"""Generated parts of the documentation: `pages.BLOCKS` names them, `tools/docs` puts them between their marks."""
