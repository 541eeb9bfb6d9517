"""The words beside the picture: what each colour and panel means."""

LEGEND = """
The **bar on top** says it in one word:
**LOCALIZED** (green): one pose holds the belief, act on it;
**AMBIGUOUS** (amber): several places fit all that was seen;
**LOST** (red): no pose deserves belief, so none is drawn;
**SILENT** (grey): no pose comes any more.

**On the map** (north up, metres):
- **arrow with a disc**, in the state's colour: the estimated pose
- **blue points**: the scan, drawn at that pose; it lies on the walls when the pose is right
- **red points**: unexpected; the map does not explain them
- **black arrow**: the true pose, where a simulator tells it
- **orange arrows**: hypotheses of the last scan; grey: improbable
- **purple lines**: tracks and their past, from 1 % on; grey: improbable

**Panels**:
- **How sure**: the confidence that the pose is within 0.5 m and 10 degrees; the belief in no track at all.
- **Error**: distance from the true pose, m.
- **Beams**: observed minus predicted range of each beam, m; blue: explained, red: unexpected.
- **Eigenspace**: the scan (blue) and its hypotheses (orange; grey: improbable) by their first three
  coefficients in the best region's space. The pale cloud is that region, all places and headings; the orange
  loop is the best hypothesis' place, turned once round: the scan lies on it when the place is right.
- **Scan and eigen-scans**: the scan's ranges (blue) and what the region's eigenspace keeps of them (orange);
  below, the first eigen-scans (purple), of which it is mixed.
- **Events**: changes of state and of the services' health.

Hidden at first: the outlines of the regions that have an eigenspace (`world/regions`).
"""
