"""Typography and colours of the page."""

CSS = """
:root { --ink:#1f2933; --soft:#616e7c; --line:#e4e7eb; --good:#2f855a; --attention:#b7791f; --bad:#c53030; }
* { box-sizing: border-box; }
body { margin:0; color:var(--ink); background:#f5f7fa; line-height:1.5;
  font:15px/1.5 system-ui,-apple-system,'Segoe UI',Roboto,'Helvetica Neue',Arial,sans-serif; }
main { max-width:1180px; margin:0 auto; padding:28px 24px 60px; }
h1 { font-size:28px; line-height:1.2; margin:0 0 4px; letter-spacing:-.01em; }
h2 { font-size:19px; margin:0 0 4px; }
h3 { font-size:14px; margin:18px 0 6px; color:var(--soft); font-weight:600; }
p { margin:4px 0 10px; max-width:76ch; }
.summary { font-size:17px; max-width:84ch; margin:10px 0 18px; }
.soft, figcaption, small { color:var(--soft); font-size:13px; }
section { background:#fff; border:1px solid var(--line); border-radius:8px; padding:18px 20px; margin-top:18px; }
.tiles { display:grid; grid-template-columns:repeat(auto-fill,minmax(205px,1fr)); gap:12px; }
.tile { background:#fff; border:1px solid var(--line); border-left:5px solid #9aa5b1; border-radius:8px;
  padding:10px 14px; }
.tile.pass { border-left-color:var(--good); } .tile.attention { border-left-color:#dd6b20; background:#fffaf3; }
.tile .name { font-size:13px; color:var(--soft); } .tile .value { font-size:24px; font-weight:650; line-height:1.3; }
.tile .against { font-size:12px; color:var(--soft); line-height:1.35; }
.tile.pass .mark { color:var(--good); } .tile.attention .mark { color:#c05621; }
.mark { font-size:13px; font-weight:600; }
.two { display:grid; grid-template-columns:1fr 1fr; gap:18px; } .two section { margin-top:18px; min-width:0; }
.three { display:grid; grid-template-columns:repeat(3,1fr); gap:12px; }
figure { margin:0; min-width:0; } figure img { width:100%; max-height:560px; object-fit:contain;
  display:block; border-radius:4px; cursor:zoom-in; }
figure.big { grid-column:1/-1; } figure.big img { max-height:none; cursor:zoom-out; }
table { border-collapse:collapse; width:100%; font-size:14px; font-variant-numeric:tabular-nums; }
th { text-align:left; font-weight:600; color:var(--soft); font-size:13px; }
td.n, th.n { text-align:right; white-space:nowrap; }
td.w { white-space:normal; }
th, td { padding:5px 10px 5px 0; border-bottom:1px solid var(--line); vertical-align:top; }
ul { margin:4px 0; padding-left:20px; }
.key { display:inline-block; width:11px; height:11px; border-radius:2px;
  margin:0 5px 0 12px; vertical-align:-1px; }
.scale { display:inline-block; width:150px; height:11px; border-radius:2px;
  vertical-align:-1px; margin:0 6px; }
.bar { display:inline-block; height:10px; background:#0072B2; border-radius:2px; vertical-align:middle; }
@media (max-width:860px) { .two, .three { grid-template-columns:1fr; } }
@media print { body { background:#fff; } section { break-inside:avoid; } }
"""

SCRIPT = """
document.querySelectorAll('figure img').forEach(i => i.addEventListener('click',
  () => i.parentElement.classList.toggle('big')));
"""
