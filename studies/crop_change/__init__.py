"""How far off is the first load of a crop on a machine whose scale was weighed in another one?"""
