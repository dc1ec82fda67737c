"""`viewer.html`: a finished map, rendered live in one page that needs nothing but a browser.

contents   what the page is told: scenes, materials, whites, the map and what is known of it
packing    the map and the meshes in few bytes, and losslessly so; unpack.js undoes it
page       the page put together: template, style, script, shaders, contents
"""
