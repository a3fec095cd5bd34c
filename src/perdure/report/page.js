// Draws every figure from the data beside it, in the colours of the page, and again when those change.
(function () {
  "use strict";
  var dark = window.matchMedia("(prefers-color-scheme: dark)");
  var options = { responsive: true, displayModeBar: false };
  function draw() {
    document.querySelectorAll("figure").forEach(function (figure) {
      var both = JSON.parse(figure.querySelector("script").textContent);
      var chart = dark.matches ? both.dark : both.light;
      Plotly.react(figure.querySelector(".plot"), chart.data, chart.layout, options);
    });
  }
  dark.addEventListener("change", draw);
  draw();
})();
