"""On the path while pyradiomics 3.0.1 is built, and never else: its setup calls what Python 3.12 took away."""

import configparser

if not hasattr(configparser, "SafeConfigParser"):
    configparser.SafeConfigParser = configparser.ConfigParser
    configparser.ConfigParser.readfp = configparser.ConfigParser.read_file
