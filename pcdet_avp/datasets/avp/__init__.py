"""The AVP record: its layout on disk (README.md beside this file), its reader and writer, and the data set class."""
