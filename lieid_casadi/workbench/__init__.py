"""The workbench: a local web page on which a model is compared with recordings and completed."""
