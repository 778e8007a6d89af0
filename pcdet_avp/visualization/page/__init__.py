"""A page of results as one HTML file: pictures and videos are part of it, and no request leaves it.

``parts`` says what a page holds, ``render`` turns it into HTML by ``page.html`` and ``page.css``, ``embed`` makes files
part of it, ``markdown`` turns our tools' reports and tables into HTML.
"""

from pcdet_avp.visualization.page.parts import Comparison, Page, Picture, Report, Section, Table, Video
from pcdet_avp.visualization.page.render import render

__all__ = ["Comparison", "Page", "Picture", "Report", "Section", "Table", "Video", "render"]
