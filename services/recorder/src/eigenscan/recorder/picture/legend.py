"""The words beside the picture: what each colour and panel means."""

LEGEND = """
### Where is the robot?
The **bar on top** says it in one word:
- **LOCALIZED** (green): one pose holds the belief; act on it.
- **AMBIGUOUS** (amber): several places fit all that was seen; the tracks show them.
- **LOST** (red): no pose deserves belief; the robot and its scan are not drawn.

### On the map (north up, metres)
| colour | what |
|---|---|
| arrow with a disc, coloured by state | the **estimated pose**; its outline holds the position with 95 % |
| black arrow | the **true pose**, where a simulator or reference tells it |
| blue points | the **scan**, drawn at the estimated pose: it lies on the walls when the pose is right |
| red points | **unexpected**: what the scan sees and the map does not explain |
| orange arrows | **hypotheses** of the last scan; grey: improbable |
| purple lines | **tracks** and their past; faint: improbable |
| thin blue lines | outlines of the regions that have an eigenspace |

### Panels
- **How sure**: the confidence that the pose is within 0.5 m and 10 degrees; the belief in no track at all.
- **Error**: distance from the true pose, m.
- **Beams**: observed minus predicted range of each beam, m; blue: explained, red: unexpected.
- **Eigenspace**: the scan (blue) among its hypotheses (orange): first three coefficients, best region.
- **Events**: changes of state and of the services' health.
"""
