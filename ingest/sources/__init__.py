"""Where CAD files come from: archives, lists of addresses and Onshape, beside plain files.

``resolve.Sources`` is the door: it turns what was given as SOURCE into inputs, each with its hash,
and brings their bytes to files when their turn comes.
"""
