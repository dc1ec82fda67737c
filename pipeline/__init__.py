"""When and where: everything around the stages."""
