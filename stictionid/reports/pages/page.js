"use strict";
(function () {
  // Layout of the canvas in CSS px; SHARE is the upper panel's part of the height.
  var LEFT = 58, RIGHT = 8, TOP = 8, BOTTOM = 34, GAP = 14, SHARE = 0.56, FEWEST = 8;

  function floats(text) {
    var raw = atob(text), bytes = new Uint8Array(raw.length);
    for (var i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
    var view = new DataView(bytes.buffer), values = new Float32Array(bytes.length / 4);
    for (var k = 0; k < values.length; k++) values[k] = view.getFloat32(4 * k, true);
    return values;
  }

  function niceStep(span, count) {
    var raw = span / Math.max(count, 1), power = Math.pow(10, Math.floor(Math.log10(raw))), share = raw / power;
    return (share <= 1 ? 1 : share <= 2 ? 2 : share <= 5 ? 5 : 10) * power;
  }

  function decimals(step) { return Math.min(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), 8); }

  function timeUnit(span) {
    return span > 259200 ? [86400, "days"] : span > 10800 ? [3600, "h"] : span > 600 ? [60, "min"] : [1, "s"];
  }

  function shown(value) {
    if (!isFinite(value)) return "no value";
    return Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-3) ? value.toExponential(3)
      : String(Number(value.toPrecision(5)));
  }

  function Trend(root) {
    var data = JSON.parse(root.querySelector("script").textContent);
    this.root = root; this.data = data; this.n = data.samples;
    this.signals = data.signals.map(function (s) {
      return { name: s.name, role: s.role, panel: s.panel, unit: s.unit, dash: s.dash, width: s.width,
        values: floats(s.data), on: true };
    });
    this.canvas = root.querySelector("canvas"); this.plot = root.querySelector(".plot");
    this.output = root.querySelector("output");
    this.from = 0; this.to = this.n - 1; this.cursor = -1; this.drag = null; this.pending = 0;
    root.hidden = false; root.parentNode.classList.add("live");
    this.listen(); this.draw();
  }

  Trend.prototype.listen = function () {
    var self = this;
    this.root.querySelectorAll("input").forEach(function (box) {
      box.checked = true;
      box.addEventListener("change", function () { self.signals[+box.value].on = box.checked; self.later(); });
    });
    this.root.querySelectorAll("button").forEach(function (button) {
      button.addEventListener("click", function () { self.act(button.dataset.do); });
    });
    this.plot.addEventListener("keydown", function (event) { if (self.key(event)) event.preventDefault(); });
    var canvas = this.canvas;
    canvas.addEventListener("pointerdown", function (event) {
      if (event.button) return;
      self.drag = { a: self.x(event), b: self.x(event) }; canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", function (event) {
      if (self.drag) self.drag.b = self.x(event);
      self.cursor = self.indexAt(self.x(event)); self.later();
    });
    canvas.addEventListener("pointerup", function (event) {
      var drag = self.drag; self.drag = null;
      if (!drag) return;
      if (Math.abs(drag.a - drag.b) > 6) self.view(self.indexAt(Math.min(drag.a, drag.b)), self.indexAt(Math.max(drag.a, drag.b)));
      else { self.cursor = self.indexAt(self.x(event)); self.later(); }
    });
    canvas.addEventListener("pointercancel", function () { self.drag = null; self.later(); });
    canvas.addEventListener("dblclick", function () { self.act("all"); });
    canvas.addEventListener("wheel", function (event) {
      // Only with Ctrl: a plain wheel scrolls the page.
      if (!event.ctrlKey) return;
      event.preventDefault(); self.zoom(event.deltaY < 0 ? 0.8 : 1.25, self.indexAt(self.x(event)));
    }, { passive: false });
    window.addEventListener("resize", function () { self.later(); });
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", function () { self.later(); });
  };

  Trend.prototype.x = function (event) { return event.clientX - this.canvas.getBoundingClientRect().left; };

  Trend.prototype.indexAt = function (x) {
    var width = this.canvas.clientWidth - LEFT - RIGHT, share = Math.min(Math.max((x - LEFT) / width, 0), 1);
    return Math.round(this.from + share * (this.to - this.from));
  };

  Trend.prototype.view = function (from, to) {
    // Whole samples only: the bounds index the arrays.
    var last = this.n - 1, span = Math.min(Math.max(Math.round(to - from), Math.min(FEWEST, last)), last);
    from = Math.min(Math.max(Math.round((from + to - span) / 2), 0), last - span);
    this.from = from; this.to = from + span; this.later();
  };

  Trend.prototype.zoom = function (factor, about) {
    var centre = about >= this.from && about <= this.to ? about : (this.from + this.to) / 2;
    var span = Math.min(Math.max((this.to - this.from) * factor, FEWEST), this.n - 1);
    var from = centre - (centre - this.from) / Math.max(this.to - this.from, 1) * span;
    from = Math.min(Math.max(from, 0), this.n - 1 - span);
    this.view(from, from + span);
  };

  Trend.prototype.act = function (what) {
    var span = this.to - this.from, move = Math.max(1, Math.round(span / 2));
    if (what === "in") this.zoom(0.5, this.cursor);
    else if (what === "out") this.zoom(2, this.cursor);
    else if (what === "left") { var a = Math.max(this.from - move, 0); this.view(a, a + span); }
    else if (what === "right") { var b = Math.min(this.to + move, this.n - 1); this.view(b - span, b); }
    else this.view(0, this.n - 1);
  };

  Trend.prototype.key = function (event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    var step = Math.max(1, Math.round((this.to - this.from) / 400)) * (event.shiftKey ? 10 : 1);
    switch (event.key) {
      case "ArrowLeft": this.move(-step); return true;
      case "ArrowRight": this.move(step); return true;
      case "+": case "=": this.act("in"); return true;
      case "-": case "_": this.act("out"); return true;
      case "PageUp": this.act("left"); return true;
      case "PageDown": this.act("right"); return true;
      case "Home": case "0": this.act("all"); return true;
      default: return false;
    }
  };

  Trend.prototype.move = function (by) {
    var inside = this.cursor >= this.from && this.cursor <= this.to;
    this.cursor = inside ? this.cursor + by : Math.round((this.from + this.to) / 2);
    this.cursor = Math.min(Math.max(this.cursor, 0), this.n - 1);
    var span = this.to - this.from;
    if (this.cursor < this.from) this.view(this.cursor, this.cursor + span);
    else if (this.cursor > this.to) this.view(this.cursor - span, this.cursor);
    else this.later();
  };

  Trend.prototype.later = function () {
    var self = this;
    if (!this.pending) this.pending = requestAnimationFrame(function () { self.pending = 0; self.draw(); });
  };

  Trend.prototype.draw = function () {
    var canvas = this.canvas, width = this.plot.clientWidth, height = width < 500 ? 340 : 440;
    if (!width) return;
    var ratio = window.devicePixelRatio || 1, pen = canvas.getContext("2d");
    canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio);
    canvas.style.height = height + "px";
    pen.setTransform(ratio, 0, 0, ratio, 0, 0); pen.clearRect(0, 0, width, height);
    pen.font = "12.5px system-ui, -apple-system, 'Segoe UI', Arial, sans-serif";
    var css = getComputedStyle(document.documentElement);
    this.colour = function (role) { return css.getPropertyValue("--" + role).trim(); };
    var room = height - TOP - BOTTOM - GAP, split = TOP + room * SHARE;
    var places = [[TOP, split], [split + GAP, height - BOTTOM]];
    this.drawn = 0;
    for (var p = 0; p < 2; p++) this.panel(pen, p, places[p][0], places[p][1], width);
    this.times(pen, width, height, places);
    if (this.drag) {
      pen.globalAlpha = 0.2; pen.fillStyle = this.colour("pv");
      pen.fillRect(Math.min(this.drag.a, this.drag.b), TOP, Math.abs(this.drag.a - this.drag.b), height - TOP - BOTTOM);
      pen.globalAlpha = 1;
    }
    this.readout(pen, width, height);
    var d = this.root.dataset;
    d.from = this.from; d.to = this.to; d.cursor = this.cursor; d.drawn = this.drawn;
    d.on = this.signals.filter(function (s) { return s.on; }).map(function (s) { return s.name; }).join(",");
    d.ink = this.colour("ink");
  };

  Trend.prototype.at = function (index, width) {
    return LEFT + (index - this.from) / Math.max(this.to - this.from, 1) * (width - LEFT - RIGHT);
  };

  Trend.prototype.panel = function (pen, p, top, bottom, width) {
    var self = this, low = Infinity, high = -Infinity;
    var lines = this.signals.filter(function (s) { return s.on && s.panel === p; });
    lines.forEach(function (s) {
      for (var i = self.from; i <= self.to; i++) {
        var v = s.values[i];
        if (v < low) low = v;
        if (v > high) high = v;
      }
    });
    if (!(low <= high)) { low = 0; high = 1; }
    var pad = high > low ? 0.06 * (high - low) : Math.max(Math.abs(high) * 0.01, 0.5);
    low -= pad; high += pad;
    var y = function (v) { return bottom - (v - low) / (high - low) * (bottom - top); };
    pen.save(); pen.beginPath(); pen.rect(LEFT, top, width - LEFT - RIGHT, bottom - top); pen.clip();
    this.bands(pen, top, bottom, width);
    pen.restore();
    var step = niceStep(high - low, (bottom - top) / 36), digits = decimals(step);
    pen.textAlign = "right"; pen.textBaseline = "middle"; pen.lineWidth = 1;
    for (var v = Math.ceil(low / step) * step; v <= high; v += step) {
      pen.strokeStyle = this.colour("grid"); pen.beginPath(); pen.moveTo(LEFT, y(v)); pen.lineTo(width - RIGHT, y(v)); pen.stroke();
      pen.fillStyle = this.colour("ink"); pen.fillText((Math.abs(v) < step / 1e6 ? 0 : v).toFixed(digits), LEFT - 6, y(v));
    }
    pen.save(); pen.translate(10, (top + bottom) / 2); pen.rotate(-Math.PI / 2); pen.textAlign = "center";
    pen.fillText(this.data.panels[p].label, 0, 0, bottom - top); pen.restore();
    pen.save(); pen.beginPath(); pen.rect(LEFT, top, width - LEFT - RIGHT, bottom - top); pen.clip();
    lines.forEach(function (s) { self.line(pen, s, y, width); });
    pen.restore();
    pen.strokeStyle = this.colour("soft"); pen.setLineDash([]); pen.lineWidth = 1;
    pen.strokeRect(LEFT, top, width - LEFT - RIGHT, bottom - top);
  };

  Trend.prototype.bands = function (pen, top, bottom, width) {
    var self = this, step = this.data.step;
    this.data.bands.forEach(function (band) {
      var a = self.at(band.from / step, width), b = Math.max(self.at(band.to / step, width), a + 1.5);
      if (b < LEFT || a > width) return;
      a = Math.max(a, LEFT - 20); b = Math.min(b, width + 20);
      if (band.role === "failing") {
        pen.fillStyle = self.colour("failing"); pen.fillRect(a, top, b - a, bottom - top);
        pen.fillStyle = self.colour("op"); pen.fillRect(a, top, b - a, 4);
      } else {
        pen.save(); pen.beginPath(); pen.rect(a, top, b - a, bottom - top); pen.clip();
        pen.strokeStyle = self.colour("unused"); pen.lineWidth = 3; pen.beginPath();
        for (var x = a - (bottom - top); x < b; x += 9) { pen.moveTo(x, bottom); pen.lineTo(x + bottom - top, top); }
        pen.stroke(); pen.restore();
      }
    });
  };

  Trend.prototype.line = function (pen, s, y, width) {
    // First, lowest, highest and last value of each pixel column: what the eye sees of any number of samples.
    var columns = Math.max(1, Math.floor(width - LEFT - RIGHT)), n = this.to - this.from + 1, down = false, self = this;
    var starts = {};
    this.data.starts.forEach(function (k) { starts[k] = true; });
    function point(i) {
      var v = s.values[i];
      if (v !== v) { down = false; return; }
      if (down) pen.lineTo(self.at(i, width), y(v)); else pen.moveTo(self.at(i, width), y(v));
      down = true; self.drawn++;
    }
    pen.strokeStyle = this.colour(s.role); pen.setLineDash(s.dash); pen.lineWidth = s.width; pen.lineJoin = "round";
    pen.beginPath();
    if (n <= 3 * columns) {
      for (var i = this.from; i <= this.to; i++) { if (starts[i]) down = false; point(i); }
    } else {
      for (var c = 0; c < columns; c++) {
        var a = this.from + Math.floor(c * n / columns), b = this.from + Math.floor((c + 1) * n / columns);
        var low = -1, high = -1;
        for (var k = a; k < b; k++) {
          var v = s.values[k];
          if (v !== v) continue;
          if (low < 0 || v < s.values[low]) low = k;
          if (high < 0 || v > s.values[high]) high = k;
        }
        if (low < 0) { down = false; continue; }
        point(Math.min(low, high));
        if (low !== high) point(Math.max(low, high));
      }
    }
    pen.stroke(); pen.setLineDash([]);
  };

  Trend.prototype.times = function (pen, width, height, places) {
    var step = this.data.step, unit = timeUnit((this.to - this.from) * step), per = step / unit[0];
    var low = this.from * per, high = this.to * per, gap = niceStep(high - low || 1, (width - LEFT - RIGHT) / 80);
    var digits = decimals(gap);
    pen.textAlign = "center"; pen.textBaseline = "top"; pen.lineWidth = 1;
    for (var t = Math.ceil(low / gap) * gap; t <= high + gap / 1e6; t += gap) {
      var x = this.at(t / per, width);
      pen.fillStyle = this.colour("ink"); pen.fillText(t.toFixed(digits), x, height - BOTTOM + 4);
      pen.strokeStyle = this.colour("soft"); pen.beginPath(); pen.moveTo(x, height - BOTTOM); pen.lineTo(x, height - BOTTOM + 4); pen.stroke();
    }
    pen.fillStyle = this.colour("ink"); pen.fillText("time, " + unit[1], LEFT + (width - LEFT - RIGHT) / 2, height - 15);
  };

  Trend.prototype.when = function (index) {
    var seconds = index * this.data.step, unit = timeUnit(seconds), text = "at " + shown(seconds) + " s";
    if (unit[0] > 1) text += " (" + (seconds / unit[0]).toFixed(2) + " " + unit[1] + ")";
    if (this.data.clock !== null) {
      var date = new Date(1000 * (this.data.clock + seconds));
      if (!isNaN(date)) text += ", " + date.toISOString().replace("T", " ").slice(0, 19);
    }
    return text;
  };

  Trend.prototype.readout = function (pen, width, height) {
    var step = this.data.step, c = this.cursor, span = shown((this.to - this.from) * step);
    if (c < this.from || c > this.to) {
      this.output.textContent = "Shown: " + this.when(this.from).slice(3) + " to " + this.when(this.to).slice(3) + ".";
      return;
    }
    var x = this.at(c, width), self = this;
    pen.strokeStyle = this.colour("ink"); pen.lineWidth = 1; pen.beginPath(); pen.moveTo(x, TOP); pen.lineTo(x, height - BOTTOM); pen.stroke();
    var values = this.signals.filter(function (s) { return s.on; }).map(function (s) {
      var v = s.values[c];
      return s.name + " " + shown(v) + (isFinite(v) && s.unit ? " " + s.unit : "");
    });
    var inside = this.data.bands.filter(function (b) { return c * step >= b.from && c * step < b.to; });
    var note = inside.some(function (b) { return b.role === "failing"; }) ? "; the model fails here" : "";
    note += inside.some(function (b) { return b.role === "unused"; }) ? "; not used in the fit" : "";
    this.output.textContent = self.when(c).replace(/^a/, "A") + ": " + values.join(", ") + note + " (" + span + " s shown).";
  };

  function sortable(region) {
    var table = region.querySelector("table"), body = table.tBodies[0], heads = table.tHead.rows[0].cells;
    Array.prototype.forEach.call(heads, function (head, column) {
      var button = document.createElement("button");
      button.type = "button"; button.textContent = head.textContent; head.textContent = ""; head.appendChild(button);
      button.addEventListener("click", function () {
        var up = head.getAttribute("aria-sort") !== "ascending";
        Array.prototype.forEach.call(heads, function (h) { h.removeAttribute("aria-sort"); });
        head.setAttribute("aria-sort", up ? "ascending" : "descending");
        var rows = Array.prototype.slice.call(body.rows);
        rows.sort(function (a, b) {
          var s = a.cells[column].textContent, t = b.cells[column].textContent, x = parseFloat(s), y = parseFloat(t);
          var order = !isNaN(x) && !isNaN(y) ? x - y : !isNaN(x) ? -1 : !isNaN(y) ? 1 : s < t ? -1 : s > t ? 1 : 0;
          return up ? order : -order;
        });
        rows.forEach(function (row) { body.appendChild(row); });
      });
    });
    var field = document.getElementById("filter");
    if (!field) return;
    var line = field.closest(".filter"), count = line.querySelector("output");
    line.hidden = false;
    field.addEventListener("input", function () {
      var wanted = field.value.toLowerCase(), left = 0;
      Array.prototype.forEach.call(body.rows, function (row) {
        row.hidden = row.textContent.toLowerCase().indexOf(wanted) < 0;
        left += row.hidden ? 0 : 1;
      });
      count.textContent = left + " of " + body.rows.length + " shown";
    });
  }

  document.querySelectorAll(".trend").forEach(function (root) { new Trend(root); });
  var compared = document.getElementById("compared");
  if (compared) sortable(compared.closest(".scroll"));
})();
