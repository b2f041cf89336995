"""Pages of the site, and the modules that fill them."""
